#pragma once
// The largest and smallest value of Bezier patches, with bounds that no point passes.
// Source: convex hull property and subdivision; README.md, "Largest differences".

#include "fitting/bezier_patches.h"

namespace celadon {

/// A value that is taken at (theta, along), and what no point of all passes, to the rounding of the coefficients.
struct Extremum {
  double value_mm = 0, bound_mm = 0;
  double theta_rad = 0, along = 0;  ///< along as BaseSurface says
};

struct Extrema {
  Extremum largest, smallest;
};

/// Halves patches, the one that reaches farthest first, until value and bound differ by at most width_mm; stops after
/// 2^16 halvings (a ridge of equal values and a tiny width), the bound still true. @pre width_mm >= 0
Extrema extrema(const BezierPatches& patches, double width_mm);

}  // namespace celadon
