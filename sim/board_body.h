#pragma once
// A calibration target on a stiff board.

#include <Eigen/Geometry>
#include <memory>
#include <string>

#include <tl/expected.hpp>

#include "sim/body.h"
#include "sim/target.h"

namespace celadon::sim {

/// How a print differs from what was meant. A point meant to lie at (x, y) lies at (1 + pitch_x) x, (1 + pitch_y) y on
/// the paper; the paper is bowed about its vertical middle line like a cylinder, without being stretched: the ends of
/// its length lie bow_mm behind the middle (below 0: in front of it).
struct PrintErrors {
  double pitch_x = 0, pitch_y = 0;
  double bow_mm = 0;
};

/// An infinitely thin board: the target in front, grey behind.
class BoardBody final : public Body {
 public:
  /// A target (Target::board) and, after "@", its pose: X,Y,Z of its middle in mm and RX,RY,RZ in degrees, by which a
  /// board that faces the x axis is turned about the axes x, y, z of the object frame, in that order. Without: upright
  /// over the table's axis, towards the camera. "held:" before the pose: in the scanner frame, in a hand, not on the
  /// table. Errors: one sentence.
  static tl::expected<std::shared_ptr<const BoardBody>, std::string> make(const std::string& text,
                                                                          const PrintErrors& errors = {});
  /// X_OB: the target's frame (x to the right, y down, z into the board; the middle of the print is its origin).
  BoardBody(Target target, const Eigen::Isometry3d& X_OB, const PrintErrors& errors = {}, bool held = false);

  double height_mm() const override { return height_; }
  double r_max_mm() const override { return r_max_; }
  bool of_revolution() const override { return false; }
  bool has_edges() const override { return true; }
  bool held() const override { return held_; }
  std::optional<BodyHit> intersect(const Ray& ray_O, double t_min, double t_max) const override;
  std::optional<BodyHit> refine(const Ray& ray_O, double t_near, int facet) const override;
  double reach_mm(const Ray& from_axis_O) const override;
  std::vector<PrintedCorner> corners() const override;
  std::vector<std::vector<Eigen::Vector3d>> printed() const override;

 private:
  Eigen::Vector3d at(double x_mm, double y_mm) const;  ///< of the print as it was meant, object frame
  std::vector<Eigen::Vector3d> outline() const;

  Target target_;
  Eigen::Isometry3d X_OB_, X_BO_;
  double stretch_x_, stretch_y_;
  double curvature_ = 0;  ///< 1 / radius of the bow, 1/mm; above 0 if the middle stands out
  bool held_;
  double height_ = 0, r_max_ = 0;
};

}  // namespace celadon::sim
