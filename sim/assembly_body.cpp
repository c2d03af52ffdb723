#include "sim/assembly_body.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr int kFacets = 64;  // numbers that each part has for its facets and surfaces

}  // namespace

AssemblyBody::AssemblyBody(const std::vector<AssembledPart>& parts) {
  for (const AssembledPart& part : parts) {
    parts_.push_back({part.body, part.at_mm, std::cos(part.turn_rad), std::sin(part.turn_rad)});
    height_ = std::max(height_, part.at_mm.z() + part.body->height_mm());
    r_max_ = std::max(r_max_, part.at_mm.head<2>().norm() + part.body->r_max_mm());
  }
}

Ray AssemblyBody::Part::to_part(const Ray& ray) const {
  const Vector3d p = ray.p - at_mm;
  const Vector3d& d = ray.d;
  return {{cos * p.x() + sin * p.y(), cos * p.y() - sin * p.x(), p.z()},
          {cos * d.x() + sin * d.y(), cos * d.y() - sin * d.x(), d.z()}};
}

BodyHit AssemblyBody::Part::from_part(const BodyHit& hit, int part) const {
  const Vector3d& n = hit.normal_O;
  return {hit.t, Vector3d(cos * n.x() - sin * n.y(), sin * n.x() + cos * n.y(), n.z()), part * kFacets + hit.surface,
          part * kFacets + hit.facet, 0};
}

std::optional<BodyHit> AssemblyBody::intersect(const Ray& ray, double t_min, double t_max) const {
  std::optional<BodyHit> first;
  for (std::size_t i = 0; i < parts_.size(); ++i) {
    const auto hit = parts_[i].body->intersect(parts_[i].to_part(ray), t_min, t_max);
    if (!hit) continue;
    t_max = hit->t;
    first = parts_[i].from_part(*hit, static_cast<int>(i));
  }
  return first;
}

std::optional<BodyHit> AssemblyBody::refine(const Ray& ray, double t_near, int facet) const {
  const int number = facet / kFacets;
  const Part& part = parts_[static_cast<std::size_t>(number)];
  const auto hit = part.body->refine(part.to_part(ray), t_near, facet % kFacets);
  if (!hit) return std::nullopt;
  return part.from_part(*hit, number);
}

// Seen from outside, back along the ray.
double AssemblyBody::reach_mm(const Ray& ray) const {
  const double outside = r_max_ + ray.p.head<2>().norm() + 1;
  const auto hit = intersect({ray.p + outside * ray.d, -ray.d}, 0, outside);
  return hit ? outside - hit->t : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace celadon::sim
