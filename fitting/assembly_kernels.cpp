// Compiled once per SIMD target.
#include "fitting/assembly_kernels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitting/assembly_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>

// Highway's scalar target is never needed: the baseline is SSSE3 or NEON at least.
#if HWY_TARGET != HWY_SCALAR
HWY_BEFORE_NAMESPACE();
namespace celadon::assembly_kernels {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<double, 4>;  // widths and rows of moments are whole numbers of these
using V = hn::Vec<D>;

HWY_INLINE int lanes() {
  return static_cast<int>(hn::Lanes(D()));
}

// to[k] += sum over m of row[m] * columns[m][k].
HWY_INLINE void translate_row(const double* row, const Translation& t, int powers, int padded, double* to) {
  const D d;
  for (int k = 0; k < padded; k += lanes()) {
    V sum = hn::LoadU(d, to + k);
    for (int m = 0; m < std::min(powers, k + lanes()); ++m)
      sum = hn::MulAdd(hn::Set(d, row[m]), hn::Load(d, t.columns[m] + k), sum);
    hn::StoreU(sum, d, to + k);
  }
}

// to += the cell's moments with powers of its interval's coordinate along u.
template <int kDegree>
HWY_INLINE void translate_along_u(const double* cell, const MomentLayout& layout, int degree, const Translation& t,
                                  double* to) {
  const D d;
  const int p = kDegree ? kDegree : degree;
  const auto rows = [&](const double* from, double* result, int powers, int padded) {
    for (int k = 0; k < padded; k += lanes())
      for (int b = 0; b < powers; ++b) {
        V sum = hn::Load(d, result + b * padded + k);
        for (int c = 0; c <= b; ++c)
          sum = hn::MulAdd(hn::Set(d, t.entry(b, c)), hn::Load(d, from + c * padded + k), sum);
        hn::Store(sum, d, result + b * padded + k);
      }
  };
  rows(cell, to, 2 * p + 1, layout.weight_lanes);
  rows(cell + layout.range(0, 0), to + layout.range(0, 0), p + 1, layout.range_lanes);
}

template <int kDegree>
void merge_column(const Column& c, double* intervals) {
  const D d;
  const MomentLayout& layout = c.layout;
  const int stride = layout.stride(), p = kDegree ? kDegree : c.degree_u, q = kDegree ? kDegree : c.degree_v;
  HWY_ALIGN double line[11 * 16 + 6 * 8 + 8];
  for (std::size_t I = 0; I < c.first->size(); ++I) {
    const int first = (*c.first)[I], last = (*c.last)[I];
    double* to = intervals + static_cast<std::ptrdiff_t>(I) * stride;
    const double* moments = c.cells + static_cast<std::ptrdiff_t>(first) * stride;
    if (last - first > 1) {
      double* sum = c.along_v ? line : to;
      if (c.along_v) std::fill(line, line + stride, 0.0);
      for (int i = first; i < last; ++i) {
        const double* cell = c.cells + static_cast<std::ptrdiff_t>(i) * stride;
        if (cell[0] > 0) translate_along_u<kDegree>(cell, layout, p, (*c.along_u)[static_cast<std::size_t>(i)], sum);
      }
      moments = line;
      if (!c.along_v) continue;
    } else if (!c.along_v) {
      for (int k = 0; k < stride; k += lanes())
        hn::Store(hn::Add(hn::Load(d, to + k), hn::Load(d, moments + k)), d, to + k);
      continue;
    }
    if (!(moments[0] > 0)) continue;
    for (int b = 0; b <= 2 * p; ++b)
      translate_row(moments + layout.weight(b, 0), *c.along_v, 2 * q + 1, layout.weight_lanes,
                    to + layout.weight(b, 0));
    for (int b = 0; b <= p; ++b)
      translate_row(moments + layout.range(b, 0), *c.along_v, q + 1, layout.range_lanes, to + layout.range(b, 0));
  }
}

void merge(const Column& c, double* intervals) {
  c.degree_u == 3 && c.degree_v == 3 ? merge_column<3>(c, intervals) : merge_column<0>(c, intervals);
}

// result[row][lane] = sum over a of moments[row][a] * table[a][lane].
template <int kRows, int kPowers, int kLanes, int kPitch>
HWY_INLINE void contract(const double* moments, int moment_pitch, int rows, int powers, int padded,
                         const double (*table)[kPitch], double (*result)[kPitch]) {
  const D d;
  const int n = kLanes ? kLanes : padded;
  for (int b = 0; b < (kRows ? kRows : rows); ++b)
    for (int k = 0; k < n; k += lanes()) {
      V sum = hn::Zero(d);
      for (int a = 0; a < (kPowers ? kPowers : powers); ++a)
        sum = hn::MulAdd(hn::Set(d, moments[b * moment_pitch + a]), hn::Load(d, table[a] + k), sum);
      hn::Store(sum, d, result[b] + k);
    }
}

template <int kDegree>
void entries_of_interval(const double* m, const MomentLayout& layout, int degree_u, int degree_v,
                         const FunctionTables& u, const FunctionTables& v, int first_u, const Entries& to) {
  constexpr int kPowers = kDegree ? 2 * kDegree + 1 : 0, kSingles = kDegree ? kDegree + 1 : 0;
  constexpr int kPairs = kDegree ? (kSingles * (kSingles + 1) / 2 + 3) / 4 * 4 : 0;
  const D d;
  const int p = kDegree ? kDegree : degree_u, q = kDegree ? kDegree : degree_v;
  const int width = kDegree ? 4 : u.width;
  HWY_ALIGN double by_row[kMaxPowers][FunctionTables::kMaxLanes];
  contract<kPowers, kPowers, kPairs>(m, layout.weight_lanes, 2 * p + 1, 2 * q + 1, (v.pairs + 3) / 4 * 4, v.pair,
                                     by_row);
  const int offsets = std::min(to.offsets, u.functions);
  double* line = to.pairs + first_u;
  for (int pair = 0; pair < v.pairs; ++pair, line += to.offsets * to.pitch)
    for (int k = 0; k < offsets * width; k += lanes()) {
      V sum = hn::Zero(d);
      for (int b = 0; b <= 2 * p; ++b) sum = hn::MulAdd(hn::Set(d, by_row[b][pair]), hn::Load(d, u.pair[b] + k), sum);
      double* at = line + k / width * to.pitch + k % width;
      hn::StoreU(hn::Add(hn::LoadU(d, at), sum), d, at);
    }

  HWY_ALIGN double range_by_row[kMaxPowers / 2 + 1][8];
  contract<kSingles, kSingles, kSingles>(m + layout.range(0, 0), layout.range_lanes, p + 1, q + 1, v.width, v.single,
                                         range_by_row);
  for (int x = 0; x < v.functions; ++x)
    for (int k = 0; k < width; k += lanes()) {
      V sum = hn::Zero(d);
      for (int b = 0; b <= p; ++b) sum = hn::MulAdd(hn::Set(d, range_by_row[b][x]), hn::Load(d, u.single[b] + k), sum);
      double* at = to.ranges + x * to.pitch + first_u + k;
      hn::StoreU(hn::Add(hn::LoadU(d, at), sum), d, at);
    }
}

void add_entries(const double* moments, const MomentLayout& layout, int degree_u, int degree_v, const FunctionTables& u,
                 const FunctionTables& v, int first_u, const Entries& to) {
  const bool cubic = degree_u == 3 && degree_v == 3 && u.functions == 4 && v.functions == 4;
  const auto chosen = cubic ? &entries_of_interval<3> : &entries_of_interval<0>;
  chosen(moments, layout, degree_u, degree_v, u, v, first_u, to);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon::assembly_kernels
HWY_AFTER_NAMESPACE();
#endif

#if HWY_ONCE
namespace celadon::assembly_kernels {

HWY_EXPORT(merge);
HWY_EXPORT(add_entries);

Translation::Translation(const Placement& at, int powers) {
  columns[0][0] = 1;
  for (int k = 1; k < powers; ++k)
    for (int m = 0; m <= k; ++m)
      columns[m][k] = (m < k ? at.shift * columns[m][k - 1] : 0) + (m > 0 ? at.scale * columns[m - 1][k - 1] : 0);
}

namespace {
void multiply(std::span<const double> a, std::span<const double> b, int lane, FunctionTables& to) {
  for (std::size_t i = 0; i < a.size(); ++i)
    for (std::size_t k = 0; k < b.size(); ++k) to.pair[i + k][lane] += a[i] * b[k];
}
FunctionTables singles(const RangeSpace& space, int interval) {
  FunctionTables table;
  table.functions = static_cast<int>(space.active(interval).size());
  table.width = table.functions <= 4 ? 4 : 8;
  for (int x = 0; x < table.functions; ++x) {
    const auto c = space.polynomial(interval, x);
    for (std::size_t power = 0; power < c.size(); ++power) table.single[power][x] = c[power];
  }
  return table;
}
}  // namespace

FunctionTables FunctionTables::along_u(const RangeSpace& space, int interval) {
  FunctionTables table = singles(space, interval);
  for (int d = 0; d < table.functions; ++d)
    for (int i = 0; i + d < table.functions; ++i, ++table.pairs)
      multiply(space.polynomial(interval, i), space.polynomial(interval, i + d), d * table.width + i, table);
  return table;
}

FunctionTables FunctionTables::along_v(const RangeSpace& space, int interval) {
  FunctionTables table = singles(space, interval);
  for (int i = 0; i < table.functions; ++i)
    for (int k = i; k < table.functions; ++k, ++table.pairs) {
      multiply(space.polynomial(interval, i), space.polynomial(interval, k), table.pairs, table);
      table.x[table.pairs] = i;
      table.y[table.pairs] = k;
    }
  return table;
}

void merge(const Column& column, double* intervals) {
  HWY_DYNAMIC_DISPATCH(merge)(column, intervals);
}
void add_entries(const double* moments, const MomentLayout& layout, int degree_u, int degree_v,
                 const FunctionTables& along_u, const FunctionTables& along_v, int first_u, const Entries& to) {
  HWY_DYNAMIC_DISPATCH(add_entries)(moments, layout, degree_u, degree_v, along_u, along_v, first_u, to);
}

}  // namespace celadon::assembly_kernels
#endif
