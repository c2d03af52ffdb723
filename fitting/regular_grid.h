#pragma once
// Least squares on a complete regular grid of ranges. Its normal matrix is the Kronecker product of the Gram matrices
// of both directions, so that each is solved by itself. Source: README.md, "Regular grids".

#include <Eigen/Core>
#include <optional>
#include <span>

#include "fitting/normal_solver.h"

namespace celadon {

using RangeGrid = Eigen::Ref<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;

/// The range function over full-circle arcs that is nearest to r_mm(i, j) at theta_i = 2 pi (i + offset_rows)/rows and
/// z_mm[j], every sample with weight 1; z in any order, not necessarily even. The same as from the sums of a MomentGrid
/// to rounding, in about the time that reading the ranges takes.
/// @returns std::nullopt if the samples do not determine it
/// @throws std::invalid_argument, naming row and column, for a range that is not finite or not positive, a z outside
/// the band of space.u, numbers of columns that differ, open arcs, or closed poles
std::optional<RangeFunction> fit_regular_grid(const FitSpace& space, const BaseArcs& arcs, const RangeGrid& r_mm,
                                              double offset_rows, std::span<const double> z_mm);

}  // namespace celadon
