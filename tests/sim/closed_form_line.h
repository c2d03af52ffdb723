#pragma once
// Where the laser line lies in a picture of the virtual scanner, from the closed form of the surface alone.

#include <algorithm>
#include <cmath>

#include "sim/optics.h"

namespace celadon::sim {

/// Where the line crosses a row, from the closed form alone: the point of sheet and surface that is seen in that row.
/// Newton's method on (theta, z) with differences; start: z_start.
struct Crossing {
  double x_px = NAN, z_mm = NAN;
};
inline Crossing closed_form(const Scene& scene, const OpticsConfig& c, double table_angle, double row, double z_start) {
  const VirtualCamera camera(c.camera, c.X_CW);
  double theta = 0, z = z_start;
  const auto point = [&](double t, double h) {
    const double r = scene.truth_r_mm(t - table_angle, h);
    return Eigen::Vector3d(r * std::cos(t), r * std::sin(t), h);
  };
  const auto off = [&](double t, double h) {
    const Eigen::Vector3d p = point(t, h);
    return Eigen::Vector2d(c.sheet.normal_W.dot(p) - c.sheet.distance_mm, camera.project(p).y() - row);
  };
  for (int i = 0; i < 30; ++i) {
    constexpr double h = 1e-6;
    const Eigen::Vector2d f = off(theta, z);
    Eigen::Matrix2d j;
    j.col(0) = (off(theta + h, z) - f) / h;
    j.col(1) = (off(theta, z + h) - f) / h;
    const Eigen::Vector2d step = j.partialPivLu().solve(f);
    theta -= step[0];
    z -= std::clamp(step[1], -5.0, 5.0);
    if (!(z > 0 && z < scene.z_max_mm())) return {};
    if (step.norm() < 1e-10) break;
  }
  return {camera.project(point(theta, z)).x(), z};
}

}  // namespace celadon::sim
