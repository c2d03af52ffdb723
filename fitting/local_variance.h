#pragma once
// Where the samples' noise is larger and where it is smaller, from what a solved member leaves of them.
// Source: README.md, "Standard deviations".

#include <Eigen/Core>

#include "fitting/cell_residuals.h"
#include "fitting/noise_correlation.h"

namespace celadon {

/// Variance of the samples over its mean, on each interval of a member with so many parameters: from blocks of
/// intervals with 256 samples. Weights must be 1 or nearly so: they are taken for numbers of samples.
/// `mean_range_mm`: below 1e-7 of it, residuals are rounding and all ratios are 1.
Eigen::MatrixXd variance_ratios(const CellResiduals& residuals, double lost_parameters, double mean_range_mm);

}  // namespace celadon
