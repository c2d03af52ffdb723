#pragma once
// Several bodies, fastened to each other.

#include <memory>
#include <vector>

#include "sim/body.h"

namespace celadon::sim {

/// A body within an assembly: turned about z, then moved.
struct AssembledPart {
  std::shared_ptr<const Body> body;
  Eigen::Vector3d at_mm = Eigen::Vector3d::Zero();  ///< z >= 0
  double turn_rad = 0;
};

/// Parts may stand in each other; they hide each other from light and camera.
class AssemblyBody final : public Body {
 public:
  /// @pre one part or more, each of at most 64 facets and without print
  explicit AssemblyBody(const std::vector<AssembledPart>& parts);

  double height_mm() const override { return height_; }
  double r_max_mm() const override { return r_max_; }
  bool of_revolution() const override { return false; }
  bool has_edges() const override { return true; }
  std::optional<BodyHit> intersect(const Ray& ray_O, double t_min, double t_max) const override;
  std::optional<BodyHit> refine(const Ray& ray_O, double t_near, int facet) const override;
  /// Of the outermost point.
  double reach_mm(const Ray& from_axis_O) const override;

 private:
  struct Part {
    std::shared_ptr<const Body> body;
    Eigen::Vector3d at_mm;
    double cos, sin;
    Ray to_part(const Ray& ray_O) const;
    BodyHit from_part(const BodyHit& hit, int part) const;
  };
  std::vector<Part> parts_;
  double height_ = 0, r_max_ = 0;
};

}  // namespace celadon::sim
