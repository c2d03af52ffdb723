#include "acquisition/lens.h"

#include <algorithm>

namespace celadon {

bool invertible(const CameraModel& camera) {
  const Lens lens(camera);
  // A distortion that folds does so at the largest radius first, so the border decides; one pixel outside it, since
  // positions lie up to half a pixel outside the centres.
  constexpr int kPointsPerSide = 64;
  const double right = camera.width_px, bottom = camera.height_px;
  const auto good = [&](double x, double y) {
    const UndistortedPoint ray = lens.undistort(x, y);
    if (!std::isfinite(ray.a) || !std::isfinite(ray.b) || !(ray.a_by_x > 0)) return false;
    const Eigen::Vector2d back = lens.project(ray.a, ray.b);
    if (!(std::hypot(back.x() - x, back.y() - y) < 1e-9)) return false;
    // On the way outwards along the ray the distance from the principal point must rise, or a nearer ray has this
    // pixel.
    double last = 0;
    for (int i = 1; i <= 16; ++i) {
      const Eigen::Vector2d p = lens.project(ray.a * i / 16, ray.b * i / 16);
      const double distance = std::hypot(p.x() - camera.cx_px.value, p.y() - camera.cy_px.value);
      if (!(distance >= last)) return false;
      last = distance;
    }
    return true;
  };
  for (int i = 0; i <= kPointsPerSide; ++i) {
    const double x = -1 + (right + 1) * i / kPointsPerSide, y = -1 + (bottom + 1) * i / kPointsPerSide;
    if (!good(x, -1) || !good(x, bottom) || !good(-1, y) || !good(right, y)) return false;
  }
  return true;
}

}  // namespace celadon
