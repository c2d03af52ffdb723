#pragma once
// Bodies of revolution whose generatrix has corners: straight generatrices between points (shafts, tapers, grooves),
// and the sphere. Rays meet them in closed form.

#include <vector>

#include "sim/body.h"

namespace celadon::sim {

/// A point of the generatrix.
struct TurnedPoint {
  double z_mm = 0, r_mm = 0;
};

/// Cylinders, cones and plane shoulders, with plane ends. Each is a surface of its own.
class TurnedBody final : public Body {
 public:
  /// @pre two points or more from z = 0 upwards, z never falls, r > 0
  explicit TurnedBody(const std::vector<TurnedPoint>& generatrix);

  double height_mm() const override { return height_; }
  double r_max_mm() const override { return r_max_; }
  bool of_revolution() const override { return true; }
  bool has_edges() const override { return true; }
  std::optional<BodyHit> intersect(const Ray& ray_O, double t_min, double t_max) const override;
  std::optional<BodyHit> refine(const Ray& ray_O, double t_near, int facet) const override;
  /// At the height of a shoulder: its outer radius.
  double reach_mm(const Ray& from_axis_O) const override;

 private:
  struct Part {  ///< of a cone or cylinder r = r0 + slope (z - z0), or of the plane z = z0
    double z0, z1, r0, r1, slope;
    bool plane;
  };
  template <class Accept>
  void meet(const Part& part, const Ray& ray, const Accept& accept) const;

  std::vector<Part> parts_;
  double height_ = 0, r_max_ = 0;
};

/// A sphere that rests on the platter.
class SphereBody final : public Body {
 public:
  explicit SphereBody(double radius_mm) : radius_(radius_mm) {}

  double height_mm() const override { return 2 * radius_; }
  double r_max_mm() const override { return radius_; }
  bool of_revolution() const override { return true; }
  bool has_edges() const override { return true; }
  std::optional<BodyHit> intersect(const Ray& ray_O, double t_min, double t_max) const override;
  std::optional<BodyHit> refine(const Ray& ray_O, double t_near, int facet) const override;
  double reach_mm(const Ray& from_axis_O) const override;

 private:
  double radius_;
};

/// From a point inside the circle x^2 + y^2 = r^2 to it, along a horizontal ray (per unit of d); NaN from outside.
double reach_of_circle(const Ray& ray, double r_mm);

}  // namespace celadon::sim
