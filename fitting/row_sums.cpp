// Compiled once per SIMD target.
#include "fitting/row_sums.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitting/row_sums.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

// Highway's scalar target lacks operations used here and is never needed: the baseline is SSSE3 or NEON at least.
#if HWY_TARGET != HWY_SCALAR
HWY_BEFORE_NAMESPACE();
namespace celadon {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<double>;

// kVectors of columns at a time stay in registers over all rows.
template <int kQ, bool kSquares, int kVectors>
HWY_INLINE void sum_columns(const RegularRows& rows, std::size_t column, double* sums) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  constexpr std::size_t kSums = kQ + (kSquares ? 2 : 1);
  hn::Vec<D> sum[kSums][kVectors];
  for (auto& line : sum)
    for (auto& part : line) part = hn::Zero(d);
  for (std::size_t i = 0; i < rows.rows; ++i) {
    const double *r = rows.r[i] + column, *factors = rows.factors + i * (kQ + 1);
    for (std::size_t k = 0; k < kVectors; ++k) {
      const auto range = hn::LoadU(d, r + k * lanes);
      for (int a = 0; a <= kQ; ++a) sum[a][k] = hn::MulAdd(range, hn::Set(d, factors[a]), sum[a][k]);
      if (kSquares) sum[kSums - 1][k] = hn::MulAdd(range, range, sum[kSums - 1][k]);
    }
  }
  for (std::size_t a = 0; a < kSums; ++a)
    for (std::size_t k = 0; k < kVectors; ++k) hn::StoreU(sum[a][k], d, sums + a * rows.columns + column + k * lanes);
}

template <int kQ, bool kSquares>
void sum_rows_of(const RegularRows& rows, double* sums) {
  const std::size_t lanes = hn::Lanes(D());
  constexpr int kVectors = HWY_MAX_BYTES == 64 ? 4 : 2;  // as many as there are registers for
  std::size_t column = 0;
  for (; column + kVectors * lanes <= rows.columns; column += kVectors * lanes)
    sum_columns<kQ, kSquares, kVectors>(rows, column, sums);
  for (; column + lanes <= rows.columns; column += lanes) sum_columns<kQ, kSquares, 1>(rows, column, sums);
  for (; column < rows.columns; ++column)
    for (std::size_t a = 0; a < kQ + (kSquares ? 2 : 1); ++a) {
      double sum = 0;
      for (std::size_t i = 0; i < rows.rows; ++i) {
        const double r = rows.r[i][column];
        sum += r * (a <= kQ ? rows.factors[i * (kQ + 1) + a] : r);
      }
      sums[a * rows.columns + column] = sum;
    }
}

template <int kQ>
void sum_rows_of_degree(const RegularRows& rows, double* sums) {
  if constexpr (kQ < 5)
    if (rows.degree_v != kQ) return sum_rows_of_degree<kQ + 1>(rows, sums);
  rows.squares ? sum_rows_of<kQ, true>(rows, sums) : sum_rows_of<kQ, false>(rows, sums);
}

void sum_rows(const RegularRows& rows, double* sums) {
  sum_rows_of_degree<1>(rows, sums);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon
HWY_AFTER_NAMESPACE();
#endif

#if HWY_ONCE
namespace celadon {

HWY_EXPORT(sum_rows);

void sum_rows(const RegularRows& rows, double* sums) {
  HWY_DYNAMIC_DISPATCH(sum_rows)(rows, sums);
}

}  // namespace celadon
#endif
