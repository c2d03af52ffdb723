#pragma once
// The whole way of an image: frames of the virtual scanner, extraction, triangulation with the true calibration,
// samples against the closed form along their rays, before any fit. Bias and spread apart, by bands of height.

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <vector>

#include "acquisition/laser_line.h"
#include "acquisition/triangulation.h"
#include "sim/device_model.h"
#include "sim/renderer.h"
#include "tests/sim/closed_form_line.h"

namespace celadon::sim {

struct Moments {
  double count = 0, sum = 0, squares = 0;
  void add(double value) {
    ++count;
    sum += value;
    squares += value * value;
  }
  double mean() const { return sum / std::max(count, 1.0); }
  double spread() const { return std::sqrt(std::max(squares / std::max(count, 1.0) - mean() * mean(), 0.0)); }
};

/// Samples of one band of heights.
struct Band {
  Moments line_px;       ///< extracted position less the closed form's in that row
  Moments line_mm;       ///< the same times the millimetres along the ray for a pixel
  Moments sample_mm;     ///< sample less surface, along the camera's ray
  Moments radius_mm;     ///< sample's radius less the surface's at its (theta, z)
  Moments mm_per_px;     ///< along the ray
  Moments optics_mm;     ///< -2.5 sigma^2 / r: a thick sheet on a convex wall, radius (sim/README.md)
  Moments noiseless_px;  ///< line_px in a picture without noise, speckle and reflection
  int outliers = 0;      ///< over 1.5 px off, or where the surface shows no line
};

struct ImagePath {
  std::map<int, Band> bands;  ///< by height / band height, rounded down
  Band all;
  int rows_with_line = 0, rows_found = 0;  ///< the closed form's; those of them with a sample
};

inline Exposure standing(std::uint64_t seed, std::uint64_t frame, double angle_rad, double laser_power) {
  Exposure e;
  e.seed = seed;
  e.frame = frame;
  e.exposure_ns = 4'000'000;
  e.first_row_end_ns = 50'000'000;
  for (int i = 0; i < 100; ++i) e.motion.samples.push_back({angle_rad, 0, laser_power});
  return e;
}

/// `frames` pictures at evenly spread table angles.
inline ImagePath measure_image_path(const DeviceConfig& device, const Scene& scene, int frames, std::uint64_t seed,
                                    double band_mm) {
  const OpticsConfig& optics = device.optics;
  OpticsConfig quiet = optics;
  quiet.speckle_contrast = 0;
  quiet.reflection = 0;
  quiet.noise = {optics.noise.pedestal, 1e9F, 1e-3F};
  const Calibration calibration = DeviceModel(device).calibration();
  const Triangulator triangulator(calibration, 0, {});
  const VirtualCamera camera(optics.camera, optics.X_CW);
  Renderer renderer(scene, optics), quiet_renderer(scene, quiet);
  const int width = optics.camera.width_px, height = optics.camera.height_px;
  CameraMode mode;
  mode.width_px = width;
  mode.height_px = height;
  mode.format = PixelFormat::grey8;
  mode.stride_bytes = static_cast<std::size_t>(width);
  std::vector<std::uint8_t> on(mode.stride_bytes * static_cast<std::size_t>(height)), off(on.size());
  std::vector<LineRow> rows(static_cast<std::size_t>(height)), quiet_rows(rows.size());
  LaserLineExtractor extractor;
  ImagePath result;

  for (int i = 0; i < frames; ++i) {
    const double angle = 2 * std::numbers::pi * i / frames;
    const auto extract = [&](Renderer& from, std::vector<LineRow>& into) {
      const auto number = static_cast<std::uint64_t>(2 * i);
      from.render(standing(seed, number, angle, 0), off, mode.stride_bytes);
      from.render(standing(seed, number + 1, angle, 1), on, mode.stride_bytes);
      extractor.extract(mode, on, off, into);
    };
    extract(quiet_renderer, quiet_rows);
    extract(renderer, rows);
    FrameInfo info;
    info.exposure_ns = 4'000'000;
    info.stamp_ns = 50'000'000 + device.camera.stamp_latency_ns;
    Profile profile;
    triangulator.triangulate(
        rows, info,
        [&](std::int64_t) {
          return AngleAtInstant{angle, 0, 0};
        },
        profile);
    std::vector<int> sample_of_row(static_cast<std::size_t>(height), -1);
    for (std::size_t k = 0; k < profile.size(); ++k) sample_of_row[profile.row[k]] = static_cast<int>(k);

    // Along the camera's ray, turned into the frame of the table.
    const Eigen::AngleAxisd back(-angle, Eigen::Vector3d::UnitZ());
    const Eigen::Vector3d centre = back * camera.centre_W();
    const auto ray = [&](double x, double y) { return Ray{centre, (back * camera.ray_W(x, y)).normalized()}; };
    const auto sheet_less_surface = [&](double x, double y) {
      const Ray r = ray(x, y);
      const Eigen::Vector3d n = back * optics.sheet.normal_W;
      const double t = (optics.sheet.distance_mm - n.dot(r.p)) / n.dot(r.d);
      const auto hit = scene.refine(r, t);
      return hit ? t - hit->t : NAN;
    };
    double z = scene.z_max_mm() / 2;
    for (int y = 0; y < height; ++y) {
      const auto row = static_cast<std::size_t>(y);
      const Crossing truth = closed_form(scene, optics, angle, y, z);
      const bool has_line = !std::isnan(truth.x_px) && truth.z_mm > 1.5 && truth.z_mm < scene.z_max_mm() - 1.5;
      if (!std::isnan(truth.z_mm)) z = truth.z_mm;
      result.rows_with_line += has_line;
      const int k = sample_of_row[row];
      if (k < 0 || !has_line) continue;
      ++result.rows_found;
      const auto at = static_cast<std::size_t>(k);
      const double r = profile.r_mm[at], theta = profile.theta_rad[at], height_mm = profile.z_mm[at];
      const double error_px = static_cast<double>(rows[row].x_px) - truth.x_px;
      const double mm_per_px = sheet_less_surface(truth.x_px + 0.5, y) - sheet_less_surface(truth.x_px - 0.5, y);
      const Eigen::Vector3d point(r * std::cos(theta), r * std::sin(theta), height_mm);
      const Ray seen = ray(static_cast<double>(rows[row].x_px), y);
      const double t = seen.d.dot(point - seen.p);
      const auto hit = scene.refine(seen, t);
      for (Band* band : {&result.bands[static_cast<int>(truth.z_mm / band_mm)], &result.all}) {
        if (!(std::abs(error_px) < 1.5) || !hit || std::isnan(mm_per_px)) {
          ++band->outliers;
          continue;
        }
        band->line_px.add(error_px);
        band->line_mm.add(error_px * mm_per_px);
        band->sample_mm.add(t - hit->t);
        band->radius_mm.add(r - scene.truth_r_mm(theta, height_mm));
        band->mm_per_px.add(mm_per_px);
        band->optics_mm.add(-2.5 * optics.sheet.sigma_mm * optics.sheet.sigma_mm / r);
        if (quiet_rows[row].x_px >= 0) {
          band->noiseless_px.add(static_cast<double>(quiet_rows[row].x_px) - truth.x_px);
        }
      }
    }
  }
  return result;
}

}  // namespace celadon::sim
