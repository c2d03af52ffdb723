#pragma once
// Values of a tensor product spline at many points, on SIMD lanes.

#include <Eigen/Core>
#include <cstddef>

#include "fitting/interval_basis.h"

namespace celadon {

/// value[k] = sum over i, j of N_i(u[k]) N_j(v[k]) coefficients(i, j), arrays of length n. Runs of equal v are cheaper.
/// The bits do not depend on the SIMD level, nor on how points are grouped into calls.
/// @pre coefficients has basis.width() - degree - 1 zero rows and columns behind the last ones, for the padding
void tensor_sum(const IntervalBasis& basis_u, const IntervalBasis& basis_v, const Eigen::MatrixXd& coefficients,
                const double* u, const double* v, std::size_t n, double* value);

}  // namespace celadon
