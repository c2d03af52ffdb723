#pragma once
// The exact map of free coefficients from a space to a finer one that contains it.

#include <Eigen/Core>

#include "fitting/range_space.h"

namespace celadon {

/// K with (fine coefficients) = K (coarse coefficients). @pre coarse is a subspace of fine over fine's breaks
Eigen::MatrixXd prolongation(const RangeSpace& coarse, const RangeSpace& fine);

}  // namespace celadon
