#pragma once
// Brown-Conrady distortion and its inverse. Formulas: CALIBRATION.md.

#include <Eigen/Core>
#include <array>
#include <cmath>

#include "acquisition/calibration.h"

namespace celadon {

/// A point on the image plane at unit distance, and its derivatives by the pixel's column and row.
struct UndistortedPoint {
  double a = 0, b = 0;            ///< X/Z and Y/Z of the ray
  double a_by_x = 0, b_by_x = 0;  ///< per pixel
  double a_by_y = 0, b_by_y = 0;
};

/// Projection between pixels and rays of one camera.
class Lens {
 public:
  explicit Lens(const CameraModel& camera)
      : inverse_fx_(1 / camera.fx_px.value),
        inverse_fy_(1 / camera.fy_px.value),
        cx_(camera.cx_px.value),
        cy_(camera.cy_px.value) {
    for (std::size_t i = 0; i < k_.size(); ++i) k_[i] = camera.distortion[i].value;
  }

  /// The ray through a pixel, by Newton's method from the distorted point with a fixed number of steps: the result for
  /// a pixel depends on nothing else. Error below 1e-9 px for every camera that invertible() accepts.
  UndistortedPoint undistort(double x_px, double y_px) const {
    const double xd = (x_px - cx_) * inverse_fx_, yd = (y_px - cy_) * inverse_fy_;
    double a = xd, b = yd;
    for (int step = 0; step < kSteps; ++step) {
      const Distorted d = distort(a, b);
      const double inverse_determinant = 1 / (d.xx * d.yy - d.xy * d.xy);
      const double ex = d.x - xd, ey = d.y - yd;
      a -= (d.yy * ex - d.xy * ey) * inverse_determinant;
      b -= (d.xx * ey - d.xy * ex) * inverse_determinant;
    }
    const Distorted d = distort(a, b);
    const double inverse_determinant = 1 / (d.xx * d.yy - d.xy * d.xy);
    const double per_x = inverse_fx_ * inverse_determinant, per_y = inverse_fy_ * inverse_determinant;
    return {a, b, d.yy * per_x, -d.xy * per_x, -d.xy * per_y, d.xx * per_y};
  }

  /// Pixel of a ray: the forward formula.
  Eigen::Vector2d project(double a, double b) const {
    const Distorted d = distort(a, b);
    return {d.x / inverse_fx_ + cx_, d.y / inverse_fy_ + cy_};
  }

 private:
  static constexpr int kSteps = 5;
  /// Distorted coordinates with their symmetric Jacobian.
  struct Distorted {
    double x, y, xx, xy, yy;
  };
  Distorted distort(double a, double b) const {
    const auto& [k1, k2, p1, p2, k3] = k_;
    const double s = a * a + b * b;
    const double g = 1 + s * (k1 + s * (k2 + s * k3));
    const double g_by_s = k1 + s * (2 * k2 + s * 3 * k3);
    return {.x = a * g + 2 * p1 * a * b + p2 * (s + 2 * a * a),
            .y = b * g + p1 * (s + 2 * b * b) + 2 * p2 * a * b,
            .xx = g + 2 * a * a * g_by_s + 2 * p1 * b + 6 * p2 * a,
            .xy = 2 * a * b * g_by_s + 2 * p1 * a + 2 * p2 * b,
            .yy = g + 2 * b * b * g_by_s + 6 * p1 * b + 2 * p2 * a};
  }

  double inverse_fx_, inverse_fy_, cx_, cy_;
  std::array<double, 5> k_{};
};

/// Whether undistort() is exact over the whole image: it returns to the pixel, and no two pixels share a ray's
/// neighbourhood (the Jacobian stays positive on the way from the principal point).
bool invertible(const CameraModel& camera);

}  // namespace celadon
