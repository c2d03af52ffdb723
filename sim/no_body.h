#pragma once
// A bare platter.

#include <limits>
#include <optional>

#include "sim/body.h"

namespace celadon::sim {

/// Nothing, in a space as wide as the platter.
class NoBody final : public Body {
 public:
  explicit NoBody(double platter_radius_mm) : radius_(platter_radius_mm) {}
  double height_mm() const override { return 1; }
  double r_max_mm() const override { return radius_; }
  bool of_revolution() const override { return true; }
  bool has_edges() const override { return false; }
  std::optional<BodyHit> intersect(const Ray&, double, double) const override { return std::nullopt; }
  std::optional<BodyHit> refine(const Ray&, double, int) const override { return std::nullopt; }
  double reach_mm(const Ray&) const override { return std::numeric_limits<double>::quiet_NaN(); }

 private:
  double radius_;
};

}  // namespace celadon::sim
