#pragma once
// An upright box. Rays meet its faces in closed form.

#include "sim/body.h"

namespace celadon::sim {

/// |x| <= width_x / 2, |y| <= width_y / 2, 0 <= z <= height. Each face is a surface of its own.
class BoxBody final : public Body {
 public:
  BoxBody(double width_x_mm, double width_y_mm, double height_mm)
      : low_(-width_x_mm / 2, -width_y_mm / 2, 0), high_(width_x_mm / 2, width_y_mm / 2, height_mm) {}

  double height_mm() const override { return high_.z(); }
  double r_max_mm() const override { return high_.head<2>().norm(); }
  bool of_revolution() const override { return false; }
  bool has_edges() const override { return true; }
  std::optional<BodyHit> intersect(const Ray& ray_O, double t_min, double t_max) const override;
  std::optional<BodyHit> refine(const Ray& ray_O, double t_near, int facet) const override;
  double reach_mm(const Ray& from_axis_O) const override;

 private:
  Eigen::Vector3d low_, high_;
};

}  // namespace celadon::sim
