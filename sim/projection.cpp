#include "sim/projection.h"

#include <cmath>

namespace celadon::sim {

VirtualCamera::VirtualCamera(const CameraIntrinsics& intrinsics, const Eigen::Isometry3d& X_CW)
    : in_(intrinsics), X_CW_(X_CW), R_WC_(X_CW.linear().transpose()), centre_W_(-R_WC_ * X_CW.translation()) {}

Eigen::Vector2d VirtualCamera::project(const Eigen::Vector3d& p_W) const {
  const Eigen::Vector3d p = X_CW_ * p_W;
  const double a = p.x() / p.z(), b = p.y() / p.z();
  const double r2 = a * a + b * b, radial = 1 + r2 * (in_.k1 + r2 * (in_.k2 + r2 * in_.k3));
  const double x = a * radial + 2 * in_.p1 * a * b + in_.p2 * (r2 + 2 * a * a);
  const double y = b * radial + in_.p1 * (r2 + 2 * b * b) + 2 * in_.p2 * a * b;
  return {in_.fx_px * x + in_.cx_px, in_.fy_px * y + in_.cy_px};
}

Eigen::Vector3d VirtualCamera::ray_W(double x_px, double y_px) const {
  const double xd = (x_px - in_.cx_px) / in_.fx_px, yd = (y_px - in_.cy_px) / in_.fy_px;
  double a = xd, b = yd;
  for (int i = 0; i < 20; ++i) {
    const double r2 = a * a + b * b, radial = 1 + r2 * (in_.k1 + r2 * (in_.k2 + r2 * in_.k3));
    const double slope = in_.k1 + r2 * (2 * in_.k2 + 3 * r2 * in_.k3);  // d radial / d r2
    const double ex = a * radial + 2 * in_.p1 * a * b + in_.p2 * (r2 + 2 * a * a) - xd;
    const double ey = b * radial + in_.p1 * (r2 + 2 * b * b) + 2 * in_.p2 * a * b - yd;
    const double xx = radial + 2 * a * a * slope + 2 * in_.p1 * b + 6 * in_.p2 * a;
    const double xy = 2 * a * b * slope + 2 * in_.p1 * a + 2 * in_.p2 * b;
    const double yy = radial + 2 * b * b * slope + 6 * in_.p1 * b + 2 * in_.p2 * a;
    const double det = xx * yy - xy * xy;
    const double da = (yy * ex - xy * ey) / det, db = (xx * ey - xy * ex) / det;
    a -= da;
    b -= db;
    if (std::abs(da) + std::abs(db) < 1e-12) break;
  }
  return R_WC_ * Eigen::Vector3d(a, b, 1);
}

}  // namespace celadon::sim
