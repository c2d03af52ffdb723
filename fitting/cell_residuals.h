#pragma once
// What a solved member leaves of the samples, interval by interval of its knots, from the sums alone.
// Source: README.md, "Standard deviations".

#include <Eigen/Core>

#include "fitting/knot_selection.h"
#include "fitting/moment_cells.h"
#include "fitting/moment_grid.h"
#include "fitting/normal_solver.h"

namespace celadon {

struct CellResiduals {
  MergedMoments moments;   ///< of the intervals
  Eigen::MatrixXd square;  ///< sum w (r - F)^2, intervals along u x around v
  Eigen::MatrixXd weight;  ///< sum w
};

/// @pre the equations are those of `sums`. Resolves an RMS of about 1e-8 of the range.
CellResiduals cell_residuals(const MomentGrid& sums, const NormalEquations& equations, const Eigen::MatrixXd& free);

/// kappa of scattered points, from the means of cells of the grid, merged to about four an unknown: the variance of
/// means over that of independent samples, 1 where chance explains it or the grid has too few cells.
/// @pre the member was solved from these sums
double scattered_kappa(const MomentGrid& sums, const LadderFit& member);

}  // namespace celadon
