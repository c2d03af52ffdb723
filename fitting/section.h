#pragma once
// The plane section of a range function at a height: its rational curve and what that encloses.
// Source: README.md, "Sections".

#include <Eigen/Core>
#include <vector>

#include "fitting/patch_extrema.h"
#include "fitting/range_function.h"

namespace celadon {

struct Section {
  int degree = 2;                   ///< q + 2
  std::vector<double> knots;        ///< clamped over [0, 4], on a cylinder those of the exact surface
  Eigen::Matrix4Xd control_points;  ///< (w x, w y, w z, w), scanner frame; the first and last coincide
  double perimeter_mm = 0, area_mm2 = 0;
  double perimeter_error_mm = 0;  ///< bound of the error of its quadrature; the area's is rounding
  double curve_error_mm = 0;      ///< largest distance from the surface that was seen; 0 where the section is exact
  Eigen::Vector3d centroid_mm = Eigen::Vector3d::Zero();  ///< of the area, scanner frame
  Extremum largest_radius, smallest_radius;               ///< about the axis of the base, to 1e-12 of the radius

  /// The curve's point at v, scanner frame.
  Eigen::Vector3d point(double v) const;
};

/// The section by the plane z = z_mm of the base frame. Over a cylinder with plane rims it is exact; over a sphere or
/// between other rims r(theta) is interpolated, over intervals that are halved until it is right to 1e-8 of its size.
/// @throws std::invalid_argument if the height is outside the band or, over a sphere, not met once at every angle; if
/// the arcs are open or F is not closed
Section section(const RangeFunction& range, double z_mm);

}  // namespace celadon
