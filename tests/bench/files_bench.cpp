// Reading clouds against the memory's own speed, text against strtod, a mesh, and a STEP file cold and warm.
// files_bench prints ratios of medians of interleaved runs.

#include <Eigen/Core>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "daemon/export/cad_client.h"
#include "daemon/files/cloud_files.h"
#include "daemon/files/mesh_files.h"
#include "fitting/range_function.h"
#include "tests/daemon/cloud_writers.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

double seconds(const std::function<void()>& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

/// Medians of each work, run in turn.
std::vector<double> medians(int runs, const std::vector<std::function<void()>>& works) {
  std::vector<std::vector<double>> times(works.size());
  for (int run = 0; run < runs; ++run) {
    for (std::size_t i = 0; i < works.size(); ++i) {
      times[i].push_back(seconds(works[i]));
    }
  }
  std::vector<double> result;
  for (const auto& column : times) {
    result.push_back(median(column));
  }
  return result;
}

double sink = 0;

void read_cloud(const std::filesystem::path& file) {
  const auto cloud = open_cloud(file, {});
  if (!cloud) {
    std::fprintf(stderr, "%s\n", cloud.error().message.c_str());
    std::exit(1);
  }
  while (const Profile* profile = (*cloud)->next()) {
    sink += profile->r_mm[0];
  }
}

void clouds(const testing::TemporaryFolder& scratch) {
  constexpr std::size_t count = 1'000'000;
  std::mt19937_64 engine(1);
  std::uniform_real_distribution<double> coordinate(-100, 100);
  testing::Points points(count);
  for (auto& point : points) {
    point = {coordinate(engine), coordinate(engine), coordinate(engine)};
  }
  const auto binary = scratch.write("b.ply", testing::ply(points, {}));
  std::string text;
  for (const auto& p : points) {
    char line[64];
    text.append(line, static_cast<std::size_t>(std::snprintf(line, sizeof line, "%.6f %.6f %.6f\n", p[0], p[1], p[2])));
  }
  const auto ascii = scratch.write("a.xyz", text);
  std::vector<char> from(12 * count, 1);
  std::vector<char> to(12 * count);
  const auto t = medians(9, {[&] {
                               std::memcpy(to.data(), from.data(), from.size());
                               sink += to[7];
                             },
                             [&] { sink += static_cast<double>(testing::read_file(binary).size()); },
                             [&] {
                               for (const auto& p : points) {
                                 sink += std::atan2(p[1], p[0]);
                               }
                             },
                             [&] { read_cloud(binary); },
                             [&] {
                               const char* at = text.c_str();
                               char* end = nullptr;
                               for (std::size_t i = 0; i < 3 * count; ++i) {
                                 sink += std::strtod(at, &end);
                                 at = end;
                               }
                             },
                             [&] { read_cloud(ascii); }});
  const double megabytes = 12e-6 * count;
  std::printf("binary PLY to (r, theta, z)  %6.0f MB/s  %5.1f Mpoints/s\n", megabytes / t[3], 1e-6 * count / t[3]);
  std::printf("  memcpy of the same bytes   %6.0f MB/s  ratio %.2f\n", megabytes / t[0], t[3] / t[0]);
  std::printf("  reading into one string    %6.0f MB/s  ratio %.2f\n", megabytes / t[1], t[3] / t[1]);
  std::printf("  std::atan2 alone           %6.1f Mpoints/s  ratio %.2f\n", 1e-6 * count / t[2], t[3] / t[2]);
  std::printf("text XYZ to (r, theta, z)    %6.0f MB/s\n", 1e-6 * static_cast<double>(text.size()) / t[5]);
  std::printf("  strtod alone, from memory  %6.0f MB/s  ratio %.2f\n", 1e-6 * static_cast<double>(text.size()) / t[4],
              t[5] / t[4]);
}

/// A general wall of 64 x 32 intervals with lobes.
RangeFunction wall_of_64_by_32() {
  const auto clamped = [](int degree, int intervals, double end) {
    std::vector<double> knots(static_cast<std::size_t>(degree), 0.0);
    for (int i = 0; i <= intervals; ++i) {
      knots.push_back(end * i / intervals);
    }
    knots.insert(knots.end(), static_cast<std::size_t>(degree), end);
    return knots;
  };
  BaseSurface base;
  base.band_end = 150;
  const auto knots_u = clamped(3, 31, 1);
  const auto knots_v = clamped(3, 64, 4);
  Eigen::MatrixXd coefficients(34, 67);
  for (Eigen::Index i = 0; i < 34; ++i) {
    for (Eigen::Index j = 0; j < 67; ++j) {
      const double theta = 2 * 3.14159265358979 * static_cast<double>(j % 66) / 66;
      coefficients(i, j) = 40 + 5 * std::sin(0.2 * static_cast<double>(i)) + 2 * std::cos(3 * theta);
    }
  }
  return {base, 3, 3, knots_u, knots_v, coefficients};
}

void solids(const testing::TemporaryFolder& scratch) {
  const RangeFunction range = wall_of_64_by_32();
  std::size_t triangles = 0;
  const auto m = medians(5, {[&] { triangles = mesh_of(range, 0.05).triangles.size(); }});
  std::printf("mesh, chord 0.05 mm          %6.1f ms  %zu triangles\n", 1e3 * m[0], triangles);

  const NurbsSurface wall = symbolic_product(range);
  std::vector<double> warm;
  const auto file = scratch.path() / "wall.step";
  const auto report = [](const tl::expected<CadResult, std::string>& result) {
    if (!result) {
      std::printf("STEP: %s\n", result.error().c_str());
    }
    return result.has_value();
  };
  if (!report(write_step(single(wall), file, {}))) {
    return;
  }
  std::vector<double> cold;
  for (int run = 0; run < 9; ++run) {
    cold.push_back(seconds([&] { report(write_step(single(wall), file, {})); }));
    auto worker = CadWorker::start();
    // The scan that hides the start: work of this process while the helper gets ready.
    const auto start = std::chrono::steady_clock::now();
    while (std::chrono::steady_clock::now() - start < std::chrono::milliseconds(150)) {
      sink += std::sqrt(sink + run);
    }
    warm.push_back(seconds([&] { report(worker->write_step(single(wall), file, {})); }));
  }
  std::printf("STEP of %d x %d control points (%ju bytes): cold %.0f ms, helper started ahead %.0f ms, ratio %.2f\n",
              wall.count_u(), wall.count_v(), static_cast<std::uintmax_t>(std::filesystem::file_size(file)),
              1e3 * median(cold), 1e3 * median(warm), median(cold) / median(warm));
}

}  // namespace
}  // namespace celadon

int main() {
  const celadon::testing::TemporaryFolder scratch;
  celadon::clouds(scratch);
  celadon::solids(scratch);
  return std::isnan(celadon::sink) ? 1 : 0;
}
