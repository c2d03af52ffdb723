#pragma once
// Cartesian to polar coordinates of many points.

#include <cstddef>

namespace celadon {

/// r = sqrt(x^2 + y^2) and theta in [0, 2 pi) of n points; 0 and 0 on the axis. Within 2 units of the last place of
/// 2 pi; the same bits on every SIMD target.
void to_polar(const double* x, const double* y, std::size_t n, double* r, double* theta_rad);

}  // namespace celadon
