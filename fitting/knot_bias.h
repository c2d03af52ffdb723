#pragma once
// How much of the object the knots of a solved member cannot follow, from what finer knots take away.
// Source: README.md, "Standard deviations".

#include <Eigen/Core>

#include "fitting/cell_residuals.h"
#include "fitting/knot_selection.h"
#include "fitting/noise_correlation.h"

namespace celadon {

/// The noise that a member's residuals are compared with.
struct LocalNoise {
  double variance = 0;     ///< of a sample of weight 1, on average (mm^2)
  Eigen::MatrixXd ratios;  ///< variance over that average, on the member's intervals
  Inflation inflation;
};

/// RMS difference (mm) between the object and what a member can follow of it, near each of its free coefficients. The
/// sum of squares that the next finer member takes away is that of the noise on its additional unknowns and that of the
/// object; what is left beyond the former, in a window of five intervals each way, shrunk towards its mean as far as it
/// scatters by chance alone. Where the sums or the samples have no finer member in a direction, it is what the next
/// coarser one misses, less by the order of the spline: right for smooth objects only. `profiles`: lines of samples
/// that share an angle; `knots`: of which directions. @pre the member is of this ladder
Eigen::MatrixXd knot_bias(const FitLadder& ladder, const MomentGrid& sums, const LadderFit& member,
                          const LocalNoise& noise, double profiles, Variation knots = {});

}  // namespace celadon
