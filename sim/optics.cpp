#include "sim/optics.h"

#include <cmath>
#include <numbers>

namespace celadon::sim {

using Eigen::Vector3d;

namespace {

constexpr double kBeside = std::numbers::pi / 6;  // of the camera, seen from above

}  // namespace

OpticsConfig default_optics(int width_px, int height_px, double sheet_offset_mm, double sheet_tilt_rad) {
  OpticsConfig config;
  const double s = height_px / 1024.0;
  config.camera = {
      width_px, height_px, 2100 * s, 2102 * s, (width_px - 1) / 2.0 + 6.3 * s, (height_px - 1) / 2.0 - 4.1 * s, -0.12,
      0.05,     4e-4,      -3e-4,    0.01};
  config.blur_px = 0.6;
  constexpr double kDistance = 300, kAbove = 12 * std::numbers::pi / 180;
  const Vector3d target(0, 0, 58);
  const Vector3d centre = target + kDistance * Vector3d(std::cos(kAbove) * std::cos(kBeside),
                                                        std::cos(kAbove) * std::sin(kBeside), std::sin(kAbove));
  const Vector3d view = (target - centre).normalized();
  const Vector3d right = view.cross(Vector3d::UnitZ()).normalized();
  Eigen::Matrix3d R_CW;
  R_CW.row(0) = right;
  R_CW.row(1) = view.cross(right);
  R_CW.row(2) = view;
  config.X_CW.linear() = R_CW;
  config.X_CW.translation() = -R_CW * centre;
  LaserSheet& sheet = config.sheet;
  sheet.normal_W = Vector3d(0, std::cos(sheet_tilt_rad), std::sin(sheet_tilt_rad));
  sheet.distance_mm = sheet_offset_mm;
  sheet.emitter_W = Vector3d(310, 0, 60);
  sheet.emitter_W.y() = (sheet_offset_mm - sheet.normal_W.z() * sheet.emitter_W.z()) / sheet.normal_W.y();
  return config;
}

Vector3d across_the_view(const Eigen::Isometry3d& X_CW) {
  return X_CW.linear().row(2).transpose().cross(Vector3d::UnitZ()).normalized() * -1;
}

LaserSheet mirrored_sheet(const LaserSheet& sheet) {
  const Vector3d across(-std::sin(kBeside), std::cos(kBeside), 0);
  const auto mirrored = [&](const Vector3d& v) -> Vector3d { return v - 2 * across.dot(v) * across; };
  LaserSheet out = sheet;
  out.normal_W = mirrored(sheet.normal_W);
  out.emitter_W = mirrored(sheet.emitter_W);
  out.azimuth_rad = 2 * kBeside - sheet.azimuth_rad;
  return out;
}

}  // namespace celadon::sim
