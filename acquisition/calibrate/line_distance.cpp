// Formulas: README.md, (3) to (6).
#include "acquisition/calibrate/line_distance.h"

#include <cmath>

namespace celadon::calibrate {

using Eigen::Vector2d;
using Eigen::Vector3d;

PlanePoint plane_point(const Ray& ray, const Vector3d& normal_C, double distance_mm) {
  PlanePoint out;
  const Vector3d& v = ray.v;
  const double nv = normal_C.dot(v), depth = distance_mm / nv;
  if (!ray.exists || !(depth > 0) || !std::isfinite(depth)) return out;
  out.exists = true;
  out.p_C = depth * v;
  Eigen::Matrix<double, 3, 2> by_ray = -depth / nv * v * normal_C.head<2>().transpose();
  by_ray(0, 0) += depth;
  by_ray(1, 1) += depth;
  out.by_pixel = by_ray * ray.by_pixel;
  out.by_camera = by_ray * ray.by_camera;
  out.by_normal = -depth / nv * v * v.transpose();
  out.by_distance = v / nv;
  return out;
}

LineDistance line_distance(const double* camera, const Vector2d& p_px, const Vector3d& normal_1_C, double distance_1_mm,
                           const Vector3d& normal_2_C, double distance_2_mm) {
  constexpr int kSteps = 6;
  constexpr double kReachedPx = 1e-10, kDefinite = 0.02;
  LineDistance out;
  Ray ray = ray_of(camera, p_px);
  Vector2d foot_px = p_px, across = Vector2d::Zero();
  for (int step = 0; step < kSteps; ++step) {
    const PlanePoint at = plane_point(ray, normal_1_C, distance_1_mm);
    if (!at.exists) return out;
    out.foot = at;
    const double height = normal_2_C.dot(at.p_C) - distance_2_mm;
    const Vector2d gradient = at.by_pixel.transpose() * normal_2_C;
    out.per_px = gradient.norm();
    if (!(out.per_px > 0)) return out;
    if (step == 0) {
      out.height_mm = height;
      out.definite = out.per_px > kDefinite * at.p_C.z() * ray.by_pixel.norm();
    }
    across = gradient / out.per_px;
    // To the line through the foot so far, at the place nearest to the pixel.
    const Vector2d next = p_px - across * (across.dot(p_px - foot_px) + height / out.per_px);
    const double moved = (next - foot_px).norm();
    if (!std::isfinite(moved)) return out;
    if (moved < kReachedPx) break;
    const Vector2d start = ray.v.head<2>() + ray.by_pixel * (next - foot_px);
    foot_px = next;
    ray = ray_of(camera, foot_px, start);
  }
  out.exists = true;
  out.distance_px = across.dot(p_px - foot_px);
  return out;
}

LineOnBoard line_on_board(const Estimate& estimate, const Eigen::Isometry3d& X_CB, const Vector2d& p_px,
                          const PlaneEstimate& laser) {
  const Vector3d m = X_CB.linear().col(2), t = X_CB.translation();
  const auto at_sag = [&](double sag_mm) {
    return line_distance(estimate.camera.data(), p_px, m, m.dot(t) + sag_mm, laser.normal_C, laser.distance_mm);
  };
  LineOnBoard out;
  out.at = at_sag(0);
  if (!out.at.exists) return out;
  const Vector2d place = (X_CB.linear().transpose() * (out.at.foot.p_C - t)).head<2>();
  out.shape = sag_shape(place.cwiseQuotient(estimate.pitch), estimate.board_radius_mm);
  if (!estimate.sag_mm.isZero(0)) out.at = at_sag(estimate.sag_mm.dot(out.shape));
  return out;
}

}  // namespace celadon::calibrate
