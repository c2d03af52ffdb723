#pragma once
// The difference of two range functions in one frame: its largest values with certified bounds, mean and RMS.
// Source: README.md, "Comparison".

#include <Eigen/Core>
#include <optional>
#include <span>

#include "fitting/patch_extrema.h"
#include "fitting/range_function.h"

namespace celadon {

/// Of a - b along the rays, over all angles and the band both have.
struct SurfaceComparison {
  double start = 0, end = 0;       ///< the common band, along the base as BaseSurface says
  Extremum largest, smallest;      ///< of the signed difference, positive where a lies outside b
  double mean_mm = 0, rms_mm = 0;  ///< all angles and heights alike, on spheres all directions; quadrature to rounding

  /// The largest distance along a ray lies between the two.
  double at_least_mm() const;
  double at_most_mm() const;
};

/// Empty if the bands have nothing in common. Bounds are wider than the differences by at most `relative_width` of
/// the largest one.
/// @pre bases, frames and arcs of both are the same (throws std::invalid_argument); relative_width > 0
std::optional<SurfaceComparison> compare(const RangeFunction& a, const RangeFunction& b, double relative_width = 1e-6);

/// a - b (mm) at angles and places along the base, one row a place; not a number where one of them has no surface.
/// @pre as above
Eigen::MatrixXd signed_differences(const RangeFunction& a, const RangeFunction& b, std::span<const double> theta_rad,
                                   std::span<const double> along);

}  // namespace celadon
