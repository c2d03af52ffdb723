#pragma once
// A single-valued surface r(psi, z) about the object's axis, closed by discs, squeezed along y.

#include <memory>

#include "sim/body.h"

namespace celadon::sim {

/// Radius of a shape and its partial derivatives at (psi, z).
struct RadiusAt {
  double r_mm = 0, r_psi = 0, r_z = 0;
};

/// A single-valued surface r(psi, z), z in [0, height].
class Shape {
 public:
  virtual ~Shape() = default;
  /// psi by its cosine and sine: rays are traced without arctangents.
  virtual RadiusAt radius(double cos_psi, double sin_psi, double z_mm) const = 0;
  virtual double height_mm() const = 0;
  virtual double r_max_mm() const = 0;
  /// Upper bound of |grad(rho - r(psi, z))|: makes ray marching safe.
  virtual double gradient_bound() const = 0;
  /// r does not depend on psi.
  virtual bool of_revolution() const = 0;
  /// The rim of its top can be in the laser's light.
  virtual bool shows_its_rim() const { return false; }
};

class RadialBody final : public Body {
 public:
  /// @pre squeeze_y > 0
  RadialBody(std::shared_ptr<const Shape> shape, double squeeze_y);

  double height_mm() const override { return height_; }
  double r_max_mm() const override;
  bool of_revolution() const override { return shape_->of_revolution() && squeeze_ == 1; }
  bool has_edges() const override { return shape_->shows_its_rim(); }
  std::optional<BodyHit> intersect(const Ray& ray_O, double t_min, double t_max) const override;
  std::optional<BodyHit> refine(const Ray& ray_O, double t_near, int facet) const override;
  /// Closed form where the cross section is an ellipse or the object is centred; else the root to rounding.
  double reach_mm(const Ray& from_axis_O) const override;

 private:
  Ray stretched(const Ray& ray_O) const;
  double implicit(const Eigen::Vector3d& p, Eigen::Vector3d* gradient) const;
  BodyHit wall_hit(const Ray& local, double t) const;
  std::optional<double> wall(const Ray& local, double t0, double t1) const;

  std::shared_ptr<const Shape> shape_;
  double squeeze_, height_;
};

}  // namespace celadon::sim
