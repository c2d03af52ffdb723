#pragma once
// The base geometries that range functions are over: the unit cylinder and the unit sphere, in a frame of their own.
// Source: thesis (2.3), (3.1), (3.5); README.md, "Base geometries".

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <memory>

#include "fitting/base_arcs.h"

namespace celadon {

class RangeFunction;

/// What a range function is over.
enum class BaseKind : std::uint8_t {
  cylinder,  ///< r over (theta, z), from the axis
  sphere     ///< rho over (theta, phi), from the centre
};

/// A base of unit radius. The coordinate along it is z in mm on the cylinder; on the sphere it is w, the parameter of
/// meridian(), 0 at the pole phi = 0 and 2 at phi = pi. The coordinate around it is theta, on arcs. A cylinder whose
/// rims are not plane has a coordinate of its own along it, and heights that say what z is.
struct BaseSurface {
  BaseKind kind = BaseKind::cylinder;
  BaseArcs arcs = BaseArcs::full_circle();
  double band_start = 0, band_end = 1;                     ///< of the coordinate along: mm, or w within [0, 2]
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();  ///< base frame in the scanner frame (lengths in mm)
  /// z(theta, along) over a cylinder with rims that are not plane: linear and rising along, over a band that holds this
  /// one, on the same arcs (rims.h). Null: z is the coordinate along.
  std::shared_ptr<const RangeFunction> heights{};

  bool spherical() const { return kind == BaseKind::sphere; }
  /// Half a circle over phi from 0 to pi, two arcs of 90 degrees: the joint lies on the equator whatever band is
  /// covered, so that sums can be gathered before it is known.
  static const BaseArcs& meridian();
  static constexpr double kMeridianEnd = 2;
  /// Height over the plane z = 0 of the base frame. @pre a cylinder
  double z_mm(double theta_rad, double along) const;
  /// The coordinate along at a height, also beyond the band. @pre a cylinder
  double along_at(double theta_rad, double z_mm) const;
  /// The coordinate along of a point of the base frame that is not the centre.
  double along_of(const Eigen::Vector3d& p_B) const;
  /// r or rho of a point of the base frame.
  double range_of(const Eigen::Vector3d& p_B) const;
};

/// A range and its derivatives with respect to theta (rad) and the coordinate along the base (mm, or w): mm per unit.
struct RangeDerivatives {
  double r_mm = 0, r_theta = 0, r_z = 0, r_theta_theta = 0, r_theta_z = 0, r_z_z = 0;
};

/// Position, unit outward normal and principal curvatures (1/mm, positive for a convex body) of a surface point,
/// scanner frame.
struct SurfacePoint {
  Eigen::Vector3d p_W;
  Eigen::Vector3d normal_W;
  double curvature_max = 0, curvature_min = 0;
};

/// The surface's point where the range has these derivatives. `along` as BaseSurface says.
/// @pre on a sphere, not at a pole
SurfacePoint surface_point(const BaseSurface& base, double theta_rad, double along, const RangeDerivatives& r);

/// The same at a pole of the sphere, from the derivatives seen along the meridians theta = 0, 45 and 90 degrees: those
/// of a function with two derivatives there.
SurfacePoint pole_point(const BaseSurface& base, double along, const RangeDerivatives (&r)[3]);

/// Cosine of the angle between the surface's normal and the ray: e_g = e_p cos_psi.
/// @pre on a sphere, not at a pole
double cos_psi(const BaseSurface& base, double theta_rad, double along, double r_mm, double r_theta, double r_along);

}  // namespace celadon
