// Bias and spread of the samples of the virtual scanner before any fit, against the closed form along the camera's
// rays. Exit code 1 if a bar is missed. Usage: image_path [frames = 120] [seed = 1]
#include <cstdio>
#include <cstdlib>

#include "tests/sim/image_path.h"

namespace {

using celadon::sim::Band;

constexpr double kBiasPx = 0.03, kSpreadRatio = 1.2;

/// The bias bar holds for what the extraction adds to the optics, which the picture without noise shows; whether both
/// together lie within it is told.
bool print_band(const char* name, const Band& b) {
  const double mm_per_px = std::abs(b.mm_per_px.mean());
  const double ratio = b.sample_mm.spread() / b.line_mm.spread();
  const double added_px = b.line_px.mean() - b.noiseless_px.mean();
  const double added_mm = std::abs(b.sample_mm.mean()) - std::abs(b.noiseless_px.mean()) * mm_per_px;
  const bool bias = std::abs(added_px) <= kBiasPx && std::abs(added_mm) <= kBiasPx * mm_per_px;
  const bool good = bias && ratio <= kSpreadRatio && b.outliers == 0;
  const bool whole = std::abs(b.line_px.mean()) <= kBiasPx && std::abs(b.sample_mm.mean()) <= kBiasPx * mm_per_px;
  std::printf("%-9s %7.0f %4d  %+7.4f %+7.4f %7.4f  %+8.5f %7.5f %6.3f  %+8.5f %+8.5f  %s%s\n", name, b.line_px.count,
              b.outliers, b.line_px.mean(), b.noiseless_px.mean(), b.line_px.spread(), b.sample_mm.mean(),
              b.sample_mm.spread(), ratio, b.radius_mm.mean(), b.optics_mm.mean(), good ? "PASS" : "over",
              whole ? "" : ", with the optics over 0.03 px");
  return good;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace celadon::sim;
  const int frames = argc > 1 ? std::atoi(argv[1]) : 120;
  const auto seed = static_cast<std::uint64_t>(argc > 2 ? std::atoll(argv[2]) : 1);
  bool good = true;
  std::printf(
      "%d frames of 1280 x 1024, seed %d. Bars: bias 0.03 px and as many mm along the ray, spread of the samples "
      "1.2 times the line's.\n",
      frames, static_cast<int>(seed));
  for (const double sigma_mm : {0.25, 0.05}) {
    for (const char* name : {"cylinder", "vase", "vase-squeezed"}) {
      DeviceConfig device = default_device(CameraConfig{});
      device.optics.sheet.sigma_mm = sigma_mm;
      const Scene scene = *Scene::make(name);
      const ImagePath path = measure_image_path(device, scene, frames, seed, 10);
      std::printf("\n%s, sheet of sigma %.2f mm: %d of %d rows have a sample\n", name, sigma_mm, path.rows_found,
                  path.rows_with_line);
      std::printf("%-9s %7s %4s  %7s %7s %7s  %8s %7s %6s  %8s %8s\n", "height mm", "samples", "out", "bias px",
                  "no noise", "spread", "bias mm", "spread", "ratio", "radius mm", "2.5s^2/r");
      for (const auto& [index, band] : path.bands) {
        char label[16];
        std::snprintf(label, sizeof label, "%3d-%d", 10 * index, 10 * index + 10);
        good = print_band(label, band) && good;
      }
      good = print_band("all", path.all) && good;
    }
  }
  return good ? 0 : 1;
}
