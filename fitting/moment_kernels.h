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
/// Samples of one profile that share v; returns the number added.
std::size_t add_profile(const Grid& grid, double v, const double* r, const double* z, std::size_t n);

/// Columns of a regular grid, prepared once: runs of columns that share a cell, and the powers of s at each column.
struct RegularColumns {
  struct Run {
    std::size_t first, count;
    int z_cell;
  };
  std::vector<Run> runs;
  std::vector<double> powers;  ///< powers[b * columns + j] = s_j^b, b = 0..p
  std::size_t columns;
};
/// Sums of one row per run: out[run * (p + 2) + b] = sum r s^b, then sum r^2. False (nothing to use) unless all its
/// values in the runs are finite and positive.
bool reduce_row(const RegularColumns& columns, int degree_u, const double* r, double* out);

/// Name of the target in use, and of each one this machine can run.
const char* target_name();

}  // namespace celadon::moment_kernels
