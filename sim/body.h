#pragma once
// What a body on the table must tell: where rays meet it and its true radius. Object frame O: z is the object's axis,
// the platter's top is z = 0.

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

namespace celadon::sim {

enum class Material : std::uint8_t { object, platter };

/// A ray p + t d; d need not be a unit vector.
struct Ray {
  Eigen::Vector3d p, d;
};

/// Where a ray meets a body from outside.
struct BodyHit {
  double t = 0;
  Eigen::Vector3d normal_O;  ///< outward, of any length
  int surface = 0;           ///< smooth part of the surface that was met, >= 0
  int facet = 0;             ///< what refine() starts from
  double print = 0;          ///< reflectance of what is printed there; 0: nothing is
};

/// A corner of a printed target.
struct PrintedCorner {
  int id = 0, corner = 0;  ///< as TargetCorner
  Eigen::Vector3d p;
};

class Body {
 public:
  Body() = default;
  virtual ~Body() = default;
  Body(const Body&) = delete;
  Body& operator=(const Body&) = delete;

  /// It lies in 0 <= z <= height and within r_max of its axis.
  virtual double height_mm() const = 0;
  virtual double r_max_mm() const = 0;
  /// Looks the same from all sides.
  virtual bool of_revolution() const = 0;
  /// Rays next to each other may meet different surfaces: the laser's fan is made denser there.
  virtual bool has_edges() const = 0;
  /// In a hand: its object frame is the scanner frame, whatever the table does.
  virtual bool held() const { return false; }

  /// The first point along the ray, t in (t_min, t_max). A ray that starts inside need not meet anything.
  virtual std::optional<BodyHit> intersect(const Ray& ray_O, double t_min, double t_max) const = 0;
  /// The point near t, close to the facet of a neighbouring ray's hit, whether or not something is before it; nothing
  /// if there is none.
  virtual std::optional<BodyHit> refine(const Ray& ray_O, double t_near, int facet) const = 0;
  /// Distance along a horizontal ray (unit length in the table frame) that begins on the table's axis; NaN if the body
  /// has no such point.
  virtual double reach_mm(const Ray& from_axis_O) const = 0;
  /// Of calibration targets: what a detector finds, and the outlines of what is printed.
  virtual std::vector<PrintedCorner> corners() const { return {}; }
  virtual std::vector<std::vector<Eigen::Vector3d>> printed() const { return {}; }
};

}  // namespace celadon::sim
