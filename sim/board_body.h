#pragma once
// A calibration target on a stiff board.

#include <Eigen/Geometry>
#include <memory>
#include <string>

#include <tl/expected.hpp>

#include "sim/body.h"
#include "sim/target.h"

namespace celadon::sim {

/// An infinitely thin board: the target in front, grey behind.
class BoardBody final : public Body {
 public:
  /// chessboard or tags, and, after "@", its pose: X,Y,Z of its middle in mm and RX,RY,RZ in degrees, by which a board
  /// that faces the x axis is turned about the axes x, y, z of the object frame, in that order. Without: upright over
  /// the table's axis, towards the camera. Errors: one sentence.
  static tl::expected<std::shared_ptr<const BoardBody>, std::string> make(const std::string& text);
  /// X_OB: the target's frame (x to the right, y down, z into the board).
  BoardBody(Target target, const Eigen::Isometry3d& X_OB);

  double height_mm() const override { return height_; }
  double r_max_mm() const override { return r_max_; }
  bool of_revolution() const override { return false; }
  bool has_edges() const override { return true; }
  std::optional<BodyHit> intersect(const Ray& ray_O, double t_min, double t_max) const override;
  std::optional<BodyHit> refine(const Ray& ray_O, double t_near, int facet) const override;
  double reach_mm(const Ray& from_axis_O) const override;
  std::vector<PrintedCorner> corners() const override;
  std::vector<std::array<Eigen::Vector3d, 4>> printed() const override;

 private:
  std::array<Eigen::Vector3d, 4> outline() const;

  Target target_;
  Eigen::Isometry3d X_OB_, X_BO_;
  double height_ = 0, r_max_ = 0;
};

}  // namespace celadon::sim
