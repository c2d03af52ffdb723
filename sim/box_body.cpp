#include "sim/box_body.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

// Face 2 k is the lower one along axis k, 2 k + 1 the upper one.
Vector3d normal_of(int face) {
  return (face % 2 == 0 ? -1.0 : 1.0) * Vector3d::Unit(face / 2);
}

}  // namespace

std::optional<BodyHit> BoxBody::refine(const Ray& ray, double /*t_near*/, int face) const {
  const int axis = face / 2;
  const Vector3d normal = normal_of(face);
  if (!(normal.dot(ray.d) < 0)) return std::nullopt;
  const double t = ((face % 2 == 0 ? low_ : high_)[axis] - ray.p[axis]) / ray.d[axis];
  const Vector3d p = ray.p + t * ray.d;
  for (int other = 0; other < 3; ++other) {
    if (other != axis && !(p[other] >= low_[other] && p[other] <= high_[other])) return std::nullopt;
  }
  return BodyHit{t, normal, face, face, 0};
}

// A ray enters a convex body once.
std::optional<BodyHit> BoxBody::intersect(const Ray& ray, double t_min, double t_max) const {
  for (int face = 0; face < 6; ++face) {
    const auto hit = refine(ray, 0, face);
    if (hit && hit->t > t_min && hit->t < t_max) return hit;
  }
  return std::nullopt;
}

double BoxBody::reach_mm(const Ray& ray) const {
  const auto& p = ray.p;
  if (!((p - low_).minCoeff() >= 0 && (high_ - p).minCoeff() >= 0)) return std::numeric_limits<double>::quiet_NaN();
  double t = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 2; ++axis) {
    if (ray.d[axis] != 0) t = std::min(t, ((ray.d[axis] > 0 ? high_ : low_)[axis] - p[axis]) / ray.d[axis]);
  }
  return t;
}

}  // namespace celadon::sim
