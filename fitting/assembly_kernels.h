#pragma once
// The inner loops of NormalEquations, compiled once per SIMD target and chosen at run time. Internal to fitting/.

#include <vector>

#include "fitting/aligned_allocator.h"
#include "fitting/moment_layout.h"
#include "fitting/range_space.h"

namespace celadon::assembly_kernels {

inline constexpr int kMaxPowers = 11;  // 2 * 5 + 1

/// Where a cell lies in its interval: t_interval = shift + scale * t_cell.
struct Placement {
  double shift = 0, scale = 1;
};

/// Powers of an interval's coordinate from those of its cell's, by the binomial theorem:
/// t_interval^k = sum over m of column(m)[k] t_cell^m.
struct Translation {
  static constexpr int kLanes = 16;
  alignas(64) double columns[kMaxPowers][kLanes] = {};
  Translation(const Placement& at, int powers);
  double entry(int k, int m) const { return columns[m][k]; }
};

/// Products of an interval's active functions, coefficients by power over lanes. Along v the lanes are the pairs
/// x <= y in any order; along u lane d * width + x is the pair (x, x + d), so that those of one d lie side by side.
struct FunctionTables {
  static constexpr int kMaxLanes = 48;  // 6 offsets of width 8
  int functions = 0, width = 4;         ///< width: 4 or 8, at least `functions`
  int pairs = 0;
  int x[kMaxLanes] = {}, y[kMaxLanes] = {};               ///< functions of each pair
  alignas(64) double pair[kMaxPowers][kMaxLanes] = {};    ///< pair[power][lane]
  alignas(64) double single[kMaxPowers / 2 + 1][8] = {};  ///< single[power][function]
  static FunctionTables along_u(const RangeSpace& space, int interval);
  static FunctionTables along_v(const RangeSpace& space, int interval);
};

/// Adds the moments of one column of cells to those of the intervals that hold them. Interval I holds the cells
/// [first[I], last[I]); `along_v` is null where the cells are as wide as the intervals.
struct Column {
  const double* cells;
  MomentLayout layout;
  int degree_u, degree_v;
  const std::vector<int>*first, *last;
  const std::vector<Translation>* along_u;  ///< per cell
  const Translation* along_v;
};
void merge(const Column& column, double* intervals);

/// Entries of one column of intervals: to[(pair * offsets + d) * pitch + i], the pair of functions (i, i + d) along u
/// times a pair along v, and ranges[x * pitch + i]. Both are padded by eight numbers at the end of each line of i.
struct Entries {
  double *pairs, *ranges;
  int offsets, pitch;
};
void add_entries(const double* moments, const MomentLayout& layout, int degree_u, int degree_v,
                 const FunctionTables& along_u, const FunctionTables& along_v, int first_u, const Entries& to);

}  // namespace celadon::assembly_kernels
