#pragma once
// What stands on the table, in closed form: a single-valued surface r(psi, z) about the object's own axis, squeezed
// along its y, placed on the platter. Gives truth, normals and ray intersections.
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
};

/// Where the object stands on the table: turned about z, then moved.
struct ObjectPose {
  double x_mm = 0, y_mm = 0, turn_rad = 0;
  bool operator==(const ObjectPose&) const = default;
};

enum class Material : std::uint8_t { object, platter };

/// A ray p + t d; d need not be a unit vector.
struct Ray {
  Eigen::Vector3d p, d;
};

struct Hit {
  double t = 0;
  Eigen::Vector3d p, normal;  ///< normal: unit, outward
  Material material = Material::object;
};

class Scene {
 public:
  /// One of names(); the error names them all.
  static tl::expected<Scene, std::string> make(const std::string& name);
  static const std::vector<std::string>& names();

  /// @pre squeeze_y > 0
  Scene(std::string name, std::shared_ptr<const Shape> shape, double squeeze_y, const ObjectPose& pose);

  const std::string& name() const { return name_; }
  const ObjectPose& pose() const { return pose_; }
  void set_pose(const ObjectPose& pose);
  double z_min_mm() const { return 0; }
  double z_max_mm() const { return height_; }
  double r_max_mm() const { return reach_; }
  double platter_radius_mm() const { return kPlatterRadius; }

  /// Distance of the surface from the table's axis at (theta, z) of the table frame; NaN outside the object's height or
  /// when the axis does not pass through the object. Closed form where the cross section is an ellipse or the object is
  /// centred; else the root of r along that ray to rounding.
  double truth_r_mm(double theta_rad, double z_mm) const;

  /// The first point of object or platter along the ray, t in (t_min, t_max). Table frame.
  std::optional<Hit> intersect(const Ray& ray, double t_min = 0,
                               double t_max = std::numeric_limits<double>::infinity()) const;
  /// The intersection with the object's wall near t, by Newton's method; nothing if it does not converge there. For
  /// rays next to one whose first hit is known.
  std::optional<Hit> refine(const Ray& ray, double t_near) const;
  /// Looks the same at every table angle.
  bool turns_invisibly() const;

 private:
  static constexpr double kPlatterRadius = 75;
  struct Local {
    Eigen::Vector3d p, d;
  };
  Local to_object(const Ray& ray) const;
  double implicit(const Eigen::Vector3d& p_O, Eigen::Vector3d* gradient) const;
  Hit wall_hit(const Ray& ray, const Local& local, double t) const;
  std::optional<double> wall(const Local& local, double t0, double t1) const;

  std::string name_;
  std::shared_ptr<const Shape> shape_;
  double squeeze_, height_, reach_ = 0;
  ObjectPose pose_;
  double cos_ = 1, sin_ = 0;
};

}  // namespace celadon::sim
