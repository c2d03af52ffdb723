// Formulas: README.md, (3) to (5).
#include "acquisition/calibrate/line_distance.h"

#include <cmath>

namespace celadon::calibrate {

using Eigen::Vector3d;

LineDistance line_distance(const Ray& ray, const Vector3d& m_C, const Vector3d& t_C, const Vector3d& normal_C,
                           double distance_mm) {
  LineDistance out;
  const Vector3d& v = ray.v;
  const double mv = m_C.dot(v), nv = normal_C.dot(v), depth = m_C.dot(t_C) / mv;
  if (!ray.exists || !(depth > 0) || !std::isfinite(depth)) return out;
  out.h_mm = nv * depth - distance_mm;
  const Eigen::RowVector2d by_ray = (depth * (normal_C - nv / mv * m_C)).head<2>().transpose();
  out.per_px = (by_ray * ray.by_pixel).norm();
  out.by_board_normal = nv / mv * (t_C - depth * v);
  out.by_board_point = nv / mv * m_C;
  out.by_laser_normal = depth * v;
  out.by_camera = by_ray * ray.by_camera;
  // A board along the laser plane has no line: what is seen there moves with nothing.
  out.exists = out.per_px > 0.02 * depth * ray.by_pixel.norm();
  return out;
}

LaserPoint laser_point(const Ray& ray, const Vector3d& normal_C, double distance_mm) {
  LaserPoint out;
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

}  // namespace celadon::calibrate
