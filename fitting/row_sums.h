#pragma once
// The inner loop of regular grids, compiled once per SIMD target and chosen at run time. Internal to fitting/.

#include <cstddef>

namespace celadon {

/// Rows of a regular grid that share a v cell, each of `columns` ranges, with q + 1 factors each: powers of its t, or
/// the values of functions there.
struct RegularRows {
  const double* const* r;
  const double* factors;  ///< factors[row * (degree_v + 1) + a], a = 0..q
  std::size_t rows, columns;
  int degree_v;
  bool squares;
};
/// sums[a * columns + j] = sum over the rows of r_j times factor a, and of r_j^2 at a = q + 1 if wanted.
void sum_rows(const RegularRows& rows, double* sums);

}  // namespace celadon
