#pragma once
// Volume, area, centroid and inertia of the solid between a surface that is closed in v and what closes its open ends:
// rays from the middle of a rim's control points to the rim, a disc where that is plane. Source: divergence theorem;
// README.md, "Volume, area, centroid, inertia".

#include <Eigen/Core>

#include "fitting/nurbs_surface.h"

namespace celadon {

/// Of a homogeneous solid, scanner frame.
struct SolidProperties {
  double volume_mm3 = 0;          ///< positive
  double lateral_area_mm2 = 0;    ///< of the surface
  double start_cap_area_mm2 = 0;  ///< of what closes the start of u; 0 at a pole
  double end_cap_area_mm2 = 0;    ///< of what closes the end of u; 0 at a pole
  Eigen::Vector3d centroid_mm = Eigen::Vector3d::Zero();
  Eigen::Matrix3d inertia_mm5 = Eigen::Matrix3d::Zero();  ///< about the centroid, unit density, axes of the scanner
  bool v_cross_u_outward = true;  ///< S_v x S_u points out of the solid: so it is for surfaces of range functions
  /// Bound of the error of quadrature by comparing two orders: of the volume and the area as parts of themselves, of
  /// the moments as parts of volume times size and size squared.
  double relative_error = 0;

  double area_mm2() const { return lateral_area_mm2 + start_cap_area_mm2 + end_cap_area_mm2; }
};

/// Gauss quadrature on every knot rectangle, halved where two orders differ by more than rounding.
/// @throws std::invalid_argument if the surface is not closed in v, its control points do not fit its knots or have
/// weights that are not positive, or no volume is enclosed
SolidProperties solid_properties(const NurbsSurface& surface);

}  // namespace celadon
