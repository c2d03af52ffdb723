#include "sim/optics.h"

#include <cmath>
#include <numbers>

namespace celadon::sim {

using Eigen::Vector3d;

OpticsConfig default_optics(int width_px, int height_px, double sheet_offset_mm, double sheet_tilt_rad) {
  OpticsConfig config;
  const double s = height_px / 1024.0;
  config.camera = {
      width_px, height_px, 2100 * s, 2102 * s, (width_px - 1) / 2.0 + 6.3 * s, (height_px - 1) / 2.0 - 4.1 * s, -0.12,
      0.05,     4e-4,      -3e-4,    0.01};
  config.blur_px = 0.6;
  constexpr double kDistance = 300, kBeside = std::numbers::pi / 6, kAbove = 12 * std::numbers::pi / 180;
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

}  // namespace celadon::sim
