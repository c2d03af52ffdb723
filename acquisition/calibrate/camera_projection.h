#pragma once
// Pixels and rays of a camera with their derivatives by everything that a calibration estimates. README.md, (1), (2).

#include <Eigen/Core>
#include <Eigen/LU>
#include <array>
#include <cmath>

namespace celadon::calibrate {

/// fx, fy, cx, cy in pixels, k1, k2, p1, p2, k3: the order of CALIBRATION.md.
using CameraParameters = std::array<double, 9>;

/// Pixel of the ray (a, b, 1), and its derivatives.
struct Projection {
  Eigen::Vector2d p_px;
  Eigen::Matrix2d by_ray;
  Eigen::Matrix<double, 2, 9> by_camera;
};

/// @param camera 9 numbers in the order of CameraParameters
inline Projection project(const double* camera, double a, double b) {
  const double fx = camera[0], fy = camera[1], k1 = camera[4], k2 = camera[5], p1 = camera[6], p2 = camera[7],
               k3 = camera[8];
  const double s = a * a + b * b, g = 1 + s * (k1 + s * (k2 + s * k3)), g_by_s = k1 + s * (2 * k2 + s * 3 * k3);
  const double x = a * g + 2 * p1 * a * b + p2 * (s + 2 * a * a), y = b * g + p1 * (s + 2 * b * b) + 2 * p2 * a * b;
  const double xy = 2 * a * b * g_by_s + 2 * p1 * a + 2 * p2 * b;
  Projection out;
  out.p_px << fx * x + camera[2], fy * y + camera[3];
  out.by_ray << fx * (g + 2 * a * a * g_by_s + 2 * p1 * b + 6 * p2 * a), fx * xy, fy * xy,
      fy * (g + 2 * b * b * g_by_s + 6 * p1 * b + 2 * p2 * a);
  out.by_camera << x, 0, 1, 0, fx * a * s, fx * a * s * s, fx * 2 * a * b, fx * (s + 2 * a * a), fx * a * s * s * s,  //
      0, y, 0, 1, fy * b * s, fy * b * s * s, fy * (s + 2 * b * b), fy * 2 * a * b, fy * b * s * s * s;
  return out;
}

/// The ray (a, b, 1) through a pixel, and its derivatives.
struct Ray {
  Eigen::Vector3d v = Eigen::Vector3d::UnitZ();
  Eigen::Matrix2d by_pixel;
  Eigen::Matrix<double, 2, 9> by_camera;
  bool exists = false;  ///< false where the distortion cannot be inverted
};

/// @param camera 9 numbers in the order of CameraParameters
/// @param start a, b near the ray
inline Ray ray_of(const double* camera, const Eigen::Vector2d& p_px, const Eigen::Vector2d& start) {
  Ray out;
  Eigen::Vector2d ab = start;
  constexpr int kSteps = 20;
  for (int step = 0; step < kSteps; ++step) {
    const Projection at = project(camera, ab.x(), ab.y());
    const Eigen::Vector2d move = at.by_ray.inverse() * (p_px - at.p_px);
    ab += move;
    if (!ab.allFinite()) return out;
    if (move.norm() < 1e-14) {
      out.exists = true;
      break;
    }
  }
  const Projection at = project(camera, ab.x(), ab.y());
  out.exists = out.exists || (at.p_px - p_px).norm() < 1e-9;
  out.v << ab, 1;
  out.by_pixel = at.by_ray.inverse();
  out.by_camera = -out.by_pixel * at.by_camera;
  return out;
}

inline Ray ray_of(const double* camera, const Eigen::Vector2d& p_px) {
  return ray_of(camera, p_px, {(p_px.x() - camera[2]) / camera[0], (p_px.y() - camera[3]) / camera[1]});
}

}  // namespace celadon::calibrate
