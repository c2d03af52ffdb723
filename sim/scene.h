#pragma once
// What stands on the table: a body, placed on the platter. Gives truth, normals and ray intersections.
//
// Frames: object frame O (z the object's axis); table frame T, which turns with the platter and coincides with the
// scanner frame at table angle 0. p_T = pose * p_O.

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "sim/board_body.h"
#include "sim/body.h"
#include "sim/paint.h"
#include "sim/radial_body.h"
#include "sim/table_pose.h"
#include "sim/target.h"
#include "sim/texture.h"

namespace celadon::sim {

/// Where the object stands on the table: turned about z, then moved.
struct ObjectPose {
  double x_mm = 0, y_mm = 0, turn_rad = 0;
  bool operator==(const ObjectPose&) const = default;
};

struct Hit {
  double t = 0;
  Eigen::Vector3d p, normal;  ///< normal: unit, outward
  Material material = Material::object;
  int surface = 0;   ///< smooth part of the object's surface, >= 0
  int facet = 0;     ///< for refine()
  double print = 0;  ///< reflectance of what is printed there; 0: nothing is
};

/// Tags of the family tag36h11, 11.2 mm wide, flat round the platter's edge: number 100 + i at i turns / count, their
/// feet outwards.
class RimTags {
 public:
  /// @pre 0 <= count <= 24
  explicit RimTags(int count);
  /// 0 beside the tags.
  double reflectance(double x_mm, double y_mm) const;
  /// By its angle; 0 without tags.
  std::size_t nearest(double x_mm, double y_mm) const;
  /// Of that tag alone; 0 beside it. @pre tag is 0 or one of nearest()
  double reflectance(std::size_t tag, double x_mm, double y_mm) const;
  std::vector<PrintedCorner> corners() const;
  std::vector<std::vector<Eigen::Vector3d>> outlines() const;

 private:
  Eigen::Vector3d on_platter(std::size_t tag, double x_mm, double y_mm) const;
  struct Placed {
    Target target;
    double cos, sin;  ///< of its angle
  };
  std::vector<Placed> tags_;
};

class Scene {
 public:
  /// One of names(); mesh:FILE, an STL or PLY file in millimetres whose z axis is put on the table's; or board:KIND
  /// with or without a pose (BoardBody::make) and with these errors of its print. The error names them all, or says
  /// what is wrong.
  static tl::expected<Scene, std::string> make(const std::string& name, const PrintErrors& print = {});
  /// Single-valued objects; besides "artefact", balls on a plate, and "empty", the bare platter.
  static const std::vector<std::string>& names();

  Scene(std::string name, std::shared_ptr<const Body> body, const ObjectPose& pose);
  /// @pre squeeze_y > 0
  Scene(std::string name, std::shared_ptr<const Shape> shape, double squeeze_y, const ObjectPose& pose);

  const std::string& name() const { return name_; }
  const ObjectPose& pose() const { return pose_; }
  void set_pose(const ObjectPose& pose);
  double z_min_mm() const { return 0; }
  double z_max_mm() const { return body_->height_mm(); }
  double r_max_mm() const { return reach_; }
  double platter_radius_mm() const { return kPlatterRadius; }

  /// Distance of the surface from the table's axis at (theta, z) of the table frame; NaN outside the object's height or
  /// where it has none. Of bodies that are not single-valued: of the outermost point.
  double truth_r_mm(double theta_rad, double z_mm) const;
  /// What the surface throws back there of red, green and blue light. @pre coloured(); truth_r_mm is a number there
  Eigen::Array3d truth_reflectance(double theta_rad, double z_mm) const;

  /// The first point of object or platter along the ray, t in (t_min, t_max). Table frame.
  std::optional<Hit> intersect(const Ray& ray, double t_min = 0,
                               double t_max = std::numeric_limits<double>::infinity()) const;
  /// The intersection with the object near t, from the facet of a neighbouring ray's hit; nothing if there is none. For
  /// rays next to one whose first hit is known.
  std::optional<Hit> refine(const Ray& ray, double t_near, int facet = 0) const;
  const RimTags& rim_tags() const { return rim_tags_; }
  bool object_is_printed() const { return !body_->corners().empty(); }
  /// The albedo of the place that was hit: 1 everywhere on an object without texture and paint.
  /// @pre of the object, not printed
  double albedo(const Hit& hit) const {
    return texture_ ? painted(hit) * texture_->albedo(point_to_object(hit.p)) : painted(hit);
  }
  /// What paint makes of it.
  double painted(const Hit& hit) const {
    return paint_.where == Paint::Where::nowhere ? 1 : paint_.albedo_at(point_to_object(hit.p));
  }
  /// Painted in colours: what it throws back of red, green and blue light at a place that was hit, with its texture.
  /// @pre of the object; coloured()
  Eigen::Array3d reflectance(const Hit& hit) const {
    const Eigen::Vector3d p_O = point_to_object(hit.p);
    return Paint::reflectance_at(p_O) * (texture_ ? texture_->albedo(p_O) : 1);
  }
  bool coloured() const { return paint_.coloured(); }
  bool textured() const { return texture_ != nullptr; }
  /// Of objects; boards and the bare platter stay as they are.
  void set_texture(std::uint64_t seed);
  void set_paint(const Paint& paint);
  /// Looks the same at every table angle.
  bool turns_invisibly() const;
  bool has_edges() const { return body_->has_edges(); }
  /// The object is in a hand: it stays where it is when the table turns. Rim tags are taken off meanwhile, so that
  /// everything that can be seen turning stands still, and table_pose() is that of angle 0 and of a lift at 0.
  bool held() const { return body_->held(); }
  /// Where the table frame is for what this scene shows.
  TablePose table_pose(const Posture& posture, const SpindleErrors& errors, const MachineAxes& axes) const {
    return held() ? TablePose({0, posture.elevation_rad, 0}, {}, axes) : TablePose(posture, errors, axes);
  }
  void set_rim_tags(int count) { rim_tags_ = RimTags(held() ? 0 : count); }
  /// Of calibration targets on body and platter, table frame: corners and outlines.
  std::vector<PrintedCorner> corners() const;
  std::vector<std::vector<Eigen::Vector3d>> printed() const;

 private:
  static constexpr double kPlatterRadius = 75;
  Eigen::Vector3d point_to_object(const Eigen::Vector3d& p_T) const;
  Ray to_object(const Ray& ray) const;
  Hit to_table(const Ray& ray, const BodyHit& hit) const;
  Eigen::Vector3d point_to_table(const Eigen::Vector3d& p_O) const;

  std::string name_;
  std::shared_ptr<const Body> body_;
  double reach_ = 0;
  ObjectPose pose_;
  double cos_ = 1, sin_ = 0;
  RimTags rim_tags_{0};
  Paint paint_;
  std::shared_ptr<const Texture> texture_;  ///< nullptr: of one colour
};

}  // namespace celadon::sim
