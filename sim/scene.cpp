#include "sim/scene.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "sim/shapes.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

struct Interval {
  double t0, t1;
};

}  // namespace

const std::vector<std::string>& Scene::names() {
  static const std::vector<std::string> kNames{"vase", "vase-squeezed", "humidifier", "cylinder", "cylinder-off"};
  return kNames;
}

tl::expected<Scene, std::string> Scene::make(const std::string& name) {
  if (name == "vase") return Scene(name, make_vase(), 1, {});
  if (name == "vase-squeezed") return Scene(name, make_vase(), 0.75, {});
  if (name == "humidifier") return Scene(name, make_humidifier(), 1, {});
  if (name == "cylinder") return Scene(name, make_cylinder(30, 100), 1, {});
  if (name == "cylinder-off") return Scene(name, make_cylinder(25, 100), 1, {6, 3, 0});
  std::string known;
  for (const std::string& n : names()) known += (known.empty() ? "" : ", ") + n;
  return tl::unexpected("scene \"" + name + "\" is unknown; choose one of " + known);
}

Scene::Scene(std::string name, std::shared_ptr<const Shape> shape, double squeeze_y, const ObjectPose& pose)
    : name_(std::move(name)), shape_(std::move(shape)), squeeze_(squeeze_y), height_(shape_->height_mm()) {
  set_pose(pose);
}

void Scene::set_pose(const ObjectPose& pose) {
  pose_ = pose;
  cos_ = std::cos(pose.turn_rad);
  sin_ = std::sin(pose.turn_rad);
  reach_ = shape_->r_max_mm() * std::max(1.0, squeeze_) + std::hypot(pose.x_mm, pose.y_mm);
}

bool Scene::turns_invisibly() const {
  return shape_->of_revolution() && squeeze_ == 1 && pose_.x_mm == 0 && pose_.y_mm == 0;
}

// Into the object frame with y stretched by 1/squeeze: the ray stays a straight line with the same parameter t.
Scene::Local Scene::to_object(const Ray& ray) const {
  const double x = ray.p.x() - pose_.x_mm, y = ray.p.y() - pose_.y_mm;
  return {{cos_ * x + sin_ * y, (cos_ * y - sin_ * x) / squeeze_, ray.p.z()},
          {cos_ * ray.d.x() + sin_ * ray.d.y(), (cos_ * ray.d.y() - sin_ * ray.d.x()) / squeeze_, ray.d.z()}};
}

// g(p) = rho - r(psi, z) and its gradient, in the stretched object frame.
double Scene::implicit(const Vector3d& p, Vector3d* gradient) const {
  const double rho = std::sqrt(p.x() * p.x() + p.y() * p.y());
  const double inverse = rho > 1e-12 ? 1 / rho : 0, c = p.x() * inverse, s = p.y() * inverse;
  const RadiusAt at = shape_->radius(c, s, p.z());
  if (gradient != nullptr) {
    const double q = at.r_psi * inverse;
    *gradient = {c + s * q, s - c * q, -at.r_z};
  }
  return rho - at.r_mm;
}

Hit Scene::wall_hit(const Ray& ray, const Local& local, double t) const {
  Vector3d g;
  implicit(local.p + t * local.d, &g);
  const double gy = g.y() / squeeze_;  // gradients pull back by the transposed map
  const Vector3d normal(cos_ * g.x() - sin_ * gy, sin_ * g.x() + cos_ * gy, g.z());
  return {t, ray.p + t * ray.d, normal.normalized(), Material::object};
}

// First root of g along the ray in [t0, t1], g(t0) > 0. Steps of g / (bound |d|) can not pass a root; close to it
// Newton's step, kept once the sign changes by bisection inside the bracket.
std::optional<double> Scene::wall(const Local& local, double t0, double t1) const {
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

std::optional<Hit> Scene::intersect(const Ray& ray, double t_min, double t_max) const {
  std::optional<Hit> platter;
  if (ray.d.z() != 0) {
    const double t = -ray.p.z() / ray.d.z();
    if (t > t_min && t < t_max) {
      const Vector3d p = ray.p + t * ray.d;
      if (p.x() * p.x() + p.y() * p.y() <= kPlatterRadius * kPlatterRadius) {
        platter = Hit{t, p, Vector3d(0, 0, ray.p.z() >= 0 ? 1 : -1), Material::platter};
        t_max = t;
      }
    }
  }
  const Local local = to_object(ray);
  // The part of the ray inside the bounding cylinder.
  const double r_max = shape_->r_max_mm();
  const double a = local.d.x() * local.d.x() + local.d.y() * local.d.y();
  const double b = local.p.x() * local.d.x() + local.p.y() * local.d.y();
  const double c = local.p.x() * local.p.x() + local.p.y() * local.p.y() - r_max * r_max;
  Interval inside{t_min, t_max};
  if (a > 0) {
    const double discriminant = b * b - a * c;
    if (discriminant < 0) return platter;
    const double root = std::sqrt(discriminant);
    inside = {std::max(t_min, (-b - root) / a), std::min(t_max, (-b + root) / a)};
  } else if (c > 0) {
    return platter;
  }
  bool through_end = false;
  if (local.d.z() != 0) {
    double near = -local.p.z() / local.d.z(), far = (height_ - local.p.z()) / local.d.z();
    if (near > far) std::swap(near, far);
    through_end = near > inside.t0;
    inside = {std::max(inside.t0, near), std::min(inside.t1, far)};
  } else if (local.p.z() < 0 || local.p.z() > height_) {
    return platter;
  }
  if (!(inside.t0 < inside.t1)) return platter;
  if (implicit(local.p + inside.t0 * local.d, nullptr) <= 0) {
    // It enters through the top or the bottom disc; a ray that starts inside sees nothing of the object.
    if (!through_end) return platter;
    return Hit{inside.t0, ray.p + inside.t0 * ray.d, Vector3d(0, 0, local.d.z() < 0 ? 1 : -1), Material::object};
  }
  if (const auto t = wall(local, inside.t0, inside.t1)) return wall_hit(ray, local, *t);
  return platter;
}

std::optional<Hit> Scene::refine(const Ray& ray, double t_near) const {
  const Local local = to_object(ray);
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
      return wall_hit(ray, local, t);
    }
  }
  return std::nullopt;
}

double Scene::truth_r_mm(double theta, double z) const {
  if (!(z >= 0 && z <= height_)) return std::numeric_limits<double>::quiet_NaN();
  const Local ray = to_object({Vector3d(0, 0, z), Vector3d(std::cos(theta), std::sin(theta), 0)});
  if (implicit(ray.p, nullptr) >= 0) return std::numeric_limits<double>::quiet_NaN();
  if (shape_->of_revolution()) {
    // |p + r d| = R(z): the positive root of a quadratic, without cancellation.
    const double radius = shape_->radius(1, 0, z).r_mm;
    const double a = ray.d.squaredNorm(), b = ray.p.x() * ray.d.x() + ray.p.y() * ray.d.y();
    const double c = ray.p.x() * ray.p.x() + ray.p.y() * ray.p.y() - radius * radius;
    const double root = std::sqrt(b * b - a * c);
    return b > 0 ? -c / (b + root) : (root - b) / a;
  }
  if (pose_.x_mm == 0 && pose_.y_mm == 0 && squeeze_ == 1) {
    const double psi = theta - pose_.turn_rad;
    return shape_->radius(std::cos(psi), std::sin(psi), z).r_mm;
  }
  // From outside inwards the first root; the surface is single-valued about the table's axis too for small offsets.
  double low = 0, high = reach_ + 1, x = high;
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
