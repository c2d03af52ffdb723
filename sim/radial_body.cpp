#include "sim/radial_body.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr int kWall = 0, kDisc = 1;

struct Interval {
  double t0, t1;
};

}  // namespace

RadialBody::RadialBody(std::shared_ptr<const Shape> shape, double squeeze_y)
    : shape_(std::move(shape)), squeeze_(squeeze_y), height_(shape_->height_mm()) {}

double RadialBody::r_max_mm() const {
  return shape_->r_max_mm() * std::max(1.0, squeeze_);
}

// With y stretched by 1/squeeze: the ray stays a straight line with the same parameter t.
Ray RadialBody::stretched(const Ray& ray) const {
  return {{ray.p.x(), ray.p.y() / squeeze_, ray.p.z()}, {ray.d.x(), ray.d.y() / squeeze_, ray.d.z()}};
}

// g(p) = rho - r(psi, z) and its gradient, in the stretched frame.
double RadialBody::implicit(const Vector3d& p, Vector3d* gradient) const {
  const double rho = std::sqrt(p.x() * p.x() + p.y() * p.y());
  const double inverse = rho > 1e-12 ? 1 / rho : 0, c = p.x() * inverse, s = p.y() * inverse;
  const RadiusAt at = shape_->radius(c, s, p.z());
  if (gradient != nullptr) {
    const double q = at.r_psi * inverse;
    *gradient = {c + s * q, s - c * q, -at.r_z};
  }
  return rho - at.r_mm;
}

BodyHit RadialBody::wall_hit(const Ray& local, double t) const {
  Vector3d g;
  implicit(local.p + t * local.d, &g);
  return {t, Vector3d(g.x(), g.y() / squeeze_, g.z()), kWall, 0, 0};  // gradients pull back by the transposed map
}

// First root of g along the ray in [t0, t1], g(t0) > 0. Steps of g / (bound |d|) can not pass a root; close to it
// Newton's step, kept once the sign changes by bisection inside the bracket.
std::optional<double> RadialBody::wall(const Ray& local, double t0, double t1) const {
  const double safe = 1 / (shape_->gradient_bound() * local.d.norm());
  constexpr double kLeastStep = 0.01;  // mm: grazing contacts shallower than this are not seen
  const double least = kLeastStep / local.d.norm();
  double t = t0;
  double low = t0;
  while (true) {
    Vector3d gradient;
    const double g = implicit(local.p + t * local.d, &gradient);
    if (g <= 0) break;
    low = t;
    if (t >= t1) return std::nullopt;
    const double slope = gradient.dot(local.d);
    double step = std::max(g * safe, least);
    if (g < 1 && slope < 0) step = std::max(step, std::min(-g / slope * 1.0001, 3 * step));
    t = std::min(t + step, t1);
  }
  double high = t, x = t;
  for (int i = 0; i < 60; ++i) {
    Vector3d gradient;
    const double g = implicit(local.p + x * local.d, &gradient);
    (g > 0 ? low : high) = x;
    const double slope = gradient.dot(local.d);
    double next = slope != 0 ? x - g / slope : low;
    if (!(next >= low && next <= high)) next = 0.5 * (low + high);
    if (std::abs(next - x) <= 1e-12 * (1 + std::abs(x))) return next;
    x = next;
  }
  return x;
}

std::optional<BodyHit> RadialBody::intersect(const Ray& ray, double t_min, double t_max) const {
  const Ray local = stretched(ray);
  // The part of the ray inside the bounding cylinder.
  const double r_max = shape_->r_max_mm();
  const double a = local.d.x() * local.d.x() + local.d.y() * local.d.y();
  const double b = local.p.x() * local.d.x() + local.p.y() * local.d.y();
  const double c = local.p.x() * local.p.x() + local.p.y() * local.p.y() - r_max * r_max;
  Interval inside{t_min, t_max};
  if (a > 0) {
    const double discriminant = b * b - a * c;
    if (discriminant < 0) return std::nullopt;
    const double root = std::sqrt(discriminant);
    inside = {std::max(t_min, (-b - root) / a), std::min(t_max, (-b + root) / a)};
  } else if (c > 0) {
    return std::nullopt;
  }
  bool through_end = false;
  if (local.d.z() != 0) {
    double near = -local.p.z() / local.d.z(), far = (height_ - local.p.z()) / local.d.z();
    if (near > far) std::swap(near, far);
    through_end = near > inside.t0;
    inside = {std::max(inside.t0, near), std::min(inside.t1, far)};
  } else if (local.p.z() < 0 || local.p.z() > height_) {
    return std::nullopt;
  }
  if (!(inside.t0 < inside.t1)) return std::nullopt;
  if (implicit(local.p + inside.t0 * local.d, nullptr) <= 0) {
    // It enters through the top or the bottom disc; a ray that starts inside sees nothing of the object.
    if (!through_end) return std::nullopt;
    return BodyHit{inside.t0, Vector3d(0, 0, local.d.z() < 0 ? 1 : -1), has_edges() ? kDisc : kWall, 0, 0};
  }
  if (const auto t = wall(local, inside.t0, inside.t1)) return wall_hit(local, *t);
  return std::nullopt;
}

std::optional<BodyHit> RadialBody::refine(const Ray& ray, double t_near, int /*facet*/) const {
  const Ray local = stretched(ray);
  double t = t_near;
  for (int i = 0; i < 8; ++i) {
    Vector3d gradient;
    const double g = implicit(local.p + t * local.d, &gradient);
    const double slope = gradient.dot(local.d);
    if (!(slope < 0)) return std::nullopt;
    const double step = -g / slope;
    t += step;
    if (std::abs(step) < 1e-7 * (1 + std::abs(t))) {  // quadratic: the next step would be below 1e-12
      const double z = local.p.z() + t * local.d.z();
      if (z < 0 || z > height_ || std::abs(t - t_near) > 10) return std::nullopt;
      return wall_hit(local, t);
    }
  }
  return std::nullopt;
}

double RadialBody::reach_mm(const Ray& from_axis) const {
  const Ray ray = stretched(from_axis);
  const double z = ray.p.z();
  if (implicit(ray.p, nullptr) >= 0) return std::numeric_limits<double>::quiet_NaN();
  if (shape_->of_revolution()) {
    // |p + r d| = R(z): the positive root of a quadratic, without cancellation.
    const double radius = shape_->radius(1, 0, z).r_mm;
    const double a = ray.d.squaredNorm(), b = ray.p.x() * ray.d.x() + ray.p.y() * ray.d.y();
    const double c = ray.p.x() * ray.p.x() + ray.p.y() * ray.p.y() - radius * radius;
    const double root = std::sqrt(b * b - a * c);
    return b > 0 ? -c / (b + root) : (root - b) / a;
  }
  if (ray.p.x() == 0 && ray.p.y() == 0 && squeeze_ == 1) return shape_->radius(ray.d.x(), ray.d.y(), z).r_mm;
  // From outside inwards the first root; the surface is single-valued about the table's axis too for small offsets.
  double low = 0, high = r_max_mm() + std::hypot(from_axis.p.x(), from_axis.p.y()) + 1, x = high;
  for (int i = 0; i < 200; ++i) {
    Vector3d gradient;
    const double g = implicit(ray.p + x * ray.d, &gradient);
    (g > 0 ? high : low) = x;
    const double slope = gradient.dot(ray.d);
    double next = slope > 0 ? x - g / slope : low;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (std::abs(next - x) <= 4e-16 * x) return next;
    x = next;
  }
  return x;
}

}  // namespace celadon::sim
