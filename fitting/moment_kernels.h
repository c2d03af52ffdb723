#pragma once
// The inner loops of MomentGrid, compiled once per SIMD target and chosen at run time. Internal to fitting/.

#include <cstddef>
#include <cstdint>
#include <vector>

#include "fitting/moment_layout.h"

namespace celadon::moment_kernels {

/// How many samples are located at a time: their scratch stays in the first cache.
inline constexpr std::size_t kBlock = 256;

/// The grid as the kernels see it. Cells lie with z fastest: index = v_cell * z_cells + z_cell.
struct Grid {
  double* cells;
  MomentLayout layout;
  int z_cells, v_cells;
  double z_start, z_scale;  ///< cells per mm
  double v_scale;           ///< cells per unit of v
};

/// At most kBlock samples with their v; weight may be null. Good ones are added; returns their number.
std::size_t add_block(const Grid& grid, const double* r, const double* z, const double* v, const double* weight,
                      std::size_t n);
/// All values are finite and positive.
bool all_positive(const double* values, std::size_t n);
/// Samples of one profile that share v; returns the number added. `positive`: all_positive(r, n).
std::size_t add_profile(const Grid& grid, double v, const double* r, const double* z, std::size_t n, bool positive);

/// out[a] = sum over k < n of x[k] y[k] of `count` pairs of arrays: x + a * step against one y.
void dot_products(const double* x, std::size_t step, int count, const double* y, std::size_t n, double* out);

/// Name of the target in use, and of each one this machine can run.
const char* target_name();

}  // namespace celadon::moment_kernels
