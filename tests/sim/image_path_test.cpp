// From pictures to samples, before any fit: a small sample of the campaign image_path.

#include "tests/sim/image_path.h"

#include <gtest/gtest.h>

namespace celadon::sim {
namespace {

ImagePath measure(const char* scene, double sheet_sigma_mm) {
  DeviceConfig device = default_device(CameraConfig{});
  device.optics.sheet.sigma_mm = sheet_sigma_mm;
  return measure_image_path(device, *Scene::make(scene), 10, 7, 20);
}

void expect_bars(const ImagePath& path) {
  EXPECT_GE(path.rows_found, 0.999 * path.rows_with_line);
  EXPECT_EQ(path.all.outliers, 0);
  for (const auto& [index, band] : path.bands) {
    EXPECT_GT(band.line_px.count, 1000) << index;
    EXPECT_LE(std::abs(band.line_px.mean() - band.noiseless_px.mean()), 0.03) << index;
    EXPECT_LE(band.sample_mm.spread(), 1.2 * band.line_mm.spread()) << index;
    // The samples are where the line says: triangulation adds nothing.
    EXPECT_NEAR(band.sample_mm.mean(), band.line_mm.mean(), 2e-4) << index;
  }
}

TEST(ImagePath, SamplesOfAThinSheetLieOnTheSurface) {
  for (const char* scene : {"cylinder", "vase", "vase-squeezed"}) {
    SCOPED_TRACE(scene);
    const ImagePath path = measure(scene, 0.05);
    expect_bars(path);
    for (const auto& [index, band] : path.bands) {
      EXPECT_LE(std::abs(band.line_px.mean()), 0.03) << index;
      EXPECT_LE(std::abs(band.sample_mm.mean()), 0.03 * std::abs(band.mm_per_px.mean())) << index;
    }
  }
}

TEST(ImagePath, AThickSheetIsPlacedAsItsOpticsSay) {
  const ImagePath path = measure("cylinder", 0.25);
  expect_bars(path);
  EXPECT_NEAR(path.all.radius_mm.mean(), path.all.optics_mm.mean(), 0.003);
}

}  // namespace
}  // namespace celadon::sim
