#include "sim/turned_body.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

// Real roots of a t^2 + 2 b t + c in rising order, without cancellation; none for a degenerate equation.
int roots_of(double a, double b, double c, std::array<double, 2>& t) {
  if (a == 0) {
    if (b == 0) return 0;
    t[0] = -0.5 * c / b;
    return 1;
  }
  const double discriminant = b * b - a * c;
  if (!(discriminant >= 0)) return 0;
  const double q = -(b + std::copysign(std::sqrt(discriminant), b));
  t = {q / a, q != 0 ? c / q : 0.0};
  if (t[0] > t[1]) std::swap(t[0], t[1]);
  return 2;
}

}  // namespace

double reach_of_circle(const Ray& ray, double r_mm) {
  const double a = ray.d.head<2>().squaredNorm(), b = ray.p.head<2>().dot(ray.d.head<2>());
  const double c = ray.p.head<2>().squaredNorm() - r_mm * r_mm;
  if (!(c <= 0)) return std::numeric_limits<double>::quiet_NaN();
  const double root = std::sqrt(b * b - a * c);
  return b > 0 ? -c / (b + root) : (root - b) / a;
}

TurnedBody::TurnedBody(const std::vector<TurnedPoint>& generatrix) {
  const auto add = [this](const TurnedPoint& from, const TurnedPoint& to) {
    const bool plane = from.z_mm == to.z_mm;
    const double slope = plane ? 0 : (to.r_mm - from.r_mm) / (to.z_mm - from.z_mm);
    parts_.push_back({from.z_mm, to.z_mm, from.r_mm, to.r_mm, slope, plane});
  };
  for (std::size_t i = 0; i + 1 < generatrix.size(); ++i) add(generatrix[i], generatrix[i + 1]);
  add({generatrix.front().z_mm, 0}, generatrix.front());
  add(generatrix.back(), {generatrix.back().z_mm, 0});
  height_ = generatrix.back().z_mm;
  for (const TurnedPoint& point : generatrix) r_max_ = std::max(r_max_, point.r_mm);
}

// Tells `accept` t and outward normal of each point of the part that the ray enters at.
template <class Accept>
void TurnedBody::meet(const Part& part, const Ray& ray, const Accept& accept) const {
  if (part.plane) {
    const double up = part.r0 > part.r1 ? 1 : -1;  // a generatrix that goes inwards faces up
    if (!(up * ray.d.z() < 0)) return;
    const double t = (part.z0 - ray.p.z()) / ray.d.z();
    const double rho2 = (ray.p + t * ray.d).head<2>().squaredNorm();
    const double inner = std::min(part.r0, part.r1), outer = std::max(part.r0, part.r1);
    if (rho2 >= inner * inner && rho2 <= outer * outer) accept(t, Vector3d(0, 0, up));
    return;
  }
  // x^2 + y^2 = (w + slope dz t)^2 with w the radius at the ray's start.
  const double w = part.r0 + part.slope * (ray.p.z() - part.z0), v = part.slope * ray.d.z();
  const double a = ray.d.head<2>().squaredNorm() - v * v, b = ray.p.head<2>().dot(ray.d.head<2>()) - w * v;
  const double c = ray.p.head<2>().squaredNorm() - w * w;
  std::array<double, 2> roots{};
  const int count = roots_of(a, b, c, roots);
  for (int i = 0; i < count; ++i) {
    const double t = roots[static_cast<std::size_t>(i)];
    const Vector3d p = ray.p + t * ray.d;
    const double r = w + v * t;  // negative on the cone's other half
    if (!(p.z() >= part.z0 && p.z() <= part.z1 && r > 0)) continue;
    const Vector3d normal(p.x(), p.y(), -part.slope * r);
    if (normal.dot(ray.d) < 0) accept(t, normal);
  }
}

std::optional<BodyHit> TurnedBody::intersect(const Ray& ray, double t_min, double t_max) const {
  std::optional<BodyHit> first;
  for (std::size_t i = 0; i < parts_.size(); ++i) {
    meet(parts_[i], ray, [&](double t, const Vector3d& normal) {
      if (!(t > t_min && t < t_max)) return;
      t_max = t;
      first = BodyHit{t, normal, static_cast<int>(i), static_cast<int>(i), 0};
    });
  }
  return first;
}

std::optional<BodyHit> TurnedBody::refine(const Ray& ray, double t_near, int facet) const {
  std::optional<BodyHit> nearest;
  meet(parts_[static_cast<std::size_t>(facet)], ray, [&](double t, const Vector3d& normal) {
    if (!nearest || std::abs(t - t_near) < std::abs(nearest->t - t_near)) nearest = BodyHit{t, normal, facet, facet, 0};
  });
  return nearest;
}

double TurnedBody::reach_mm(const Ray& ray) const {
  const double z = ray.p.z();
  double r = 0;
  for (const Part& part : parts_) {
    if (!part.plane && z >= part.z0 && z <= part.z1) r = std::max(r, part.r0 + part.slope * (z - part.z0));
  }
  return reach_of_circle(ray, r);
}

std::optional<BodyHit> SphereBody::intersect(const Ray& ray, double t_min, double t_max) const {
  const auto hit = refine(ray, 0, 0);
  return hit && hit->t > t_min && hit->t < t_max ? hit : std::nullopt;
}

// A ray enters a sphere once.
std::optional<BodyHit> SphereBody::refine(const Ray& ray, double /*t_near*/, int /*facet*/) const {
  const Vector3d from = ray.p - Vector3d(0, 0, radius_);
  std::array<double, 2> roots{};
  if (roots_of(ray.d.squaredNorm(), from.dot(ray.d), from.squaredNorm() - radius_ * radius_, roots) == 0) {
    return std::nullopt;
  }
  return BodyHit{roots[0], from + roots[0] * ray.d, 0, 0, 0};
}

double SphereBody::reach_mm(const Ray& ray) const {
  const double z = ray.p.z();
  return reach_of_circle(ray, std::sqrt(std::max(0.0, z * (2 * radius_ - z))));
}

}  // namespace celadon::sim
