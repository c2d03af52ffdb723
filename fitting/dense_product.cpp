// Compiled once per SIMD target.
#include "fitting/dense_product.h"

// Arrays of vectors need a fixed vector size.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitting/dense_product.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef CELADON_FITTING_DENSE_PRODUCT_ONCE
#define CELADON_FITTING_DENSE_PRODUCT_ONCE
namespace celadon {
namespace {
// c += factor a b, column by column; b's element (k, j) is at k * inner_step + j * column_step.
struct DenseProduct {
  const double *a, *b;
  double* c;
  std::ptrdiff_t rows, columns, inner;  // rows: of a and c, also from column to column
  std::ptrdiff_t inner_step, column_step;
  double factor;
};
}  // namespace
}  // namespace celadon
#endif

// Highway's scalar target is never needed: the baseline is SSSE3 or NEON at least.
#if HWY_TARGET != HWY_SCALAR
HWY_BEFORE_NAMESPACE();
namespace celadon {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<double, 4>;
using V = hn::Vec<D>;
constexpr std::ptrdiff_t kLanes = static_cast<std::ptrdiff_t>(hn::MaxLanes(D()));

// A tile of c stays in registers over the whole inner dimension.
template <int kVectors, int kColumns>
HWY_INLINE void tile(const DenseProduct& m, std::ptrdiff_t row, std::ptrdiff_t column) {
  const D d;
  V sum[kVectors][kColumns];
  for (int i = 0; i < kVectors; ++i)
    for (int j = 0; j < kColumns; ++j) sum[i][j] = hn::Zero(d);
  const double *a = m.a + row, *b = m.b + column * m.column_step;
  for (std::ptrdiff_t k = 0; k < m.inner; ++k, a += m.rows, b += m.inner_step) {
    V left[kVectors];
    for (int i = 0; i < kVectors; ++i) left[i] = hn::LoadU(d, a + i * kLanes);
    for (int j = 0; j < kColumns; ++j) {
      const V right = hn::Set(d, b[j * m.column_step]);
      for (int i = 0; i < kVectors; ++i) sum[i][j] = hn::MulAdd(left[i], right, sum[i][j]);
    }
  }
  for (int j = 0; j < kColumns; ++j)
    for (int i = 0; i < kVectors; ++i) {
      double* at = m.c + (column + j) * m.rows + row + i * kLanes;
      hn::StoreU(hn::MulAdd(hn::Set(d, m.factor), sum[i][j], hn::LoadU(d, at)), d, at);
    }
}

template <int kColumns>
HWY_INLINE void columns(const DenseProduct& m, std::ptrdiff_t column) {
  std::ptrdiff_t row = 0;
  for (; row + 3 * kLanes <= m.rows; row += 3 * kLanes) tile<3, kColumns>(m, row, column);
  for (; row < m.rows; row += kLanes) tile<1, kColumns>(m, row, column);
}

void product(const DenseProduct& m) {
  std::ptrdiff_t column = 0;
  for (; column + 4 <= m.columns; column += 4) columns<4>(m, column);
  for (; column < m.columns; ++column) columns<1>(m, column);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon
HWY_AFTER_NAMESPACE();
#endif  // not scalar

#if HWY_ONCE
namespace celadon {
namespace {
HWY_EXPORT(product);
}  // namespace

Eigen::MatrixXd with_padded_rows(const Eigen::MatrixXd& matrix) {
  Eigen::MatrixXd result = Eigen::MatrixXd::Zero(padded_rows(matrix.rows()), matrix.cols());
  result.topRows(matrix.rows()) = matrix;
  return result;
}

void add_product(double factor, const Eigen::MatrixXd& a, const Eigen::MatrixXd& b, Eigen::MatrixXd& c) {
  HWY_DYNAMIC_DISPATCH(product)
  ({a.data(), b.data(), c.data(), c.rows(), c.cols(), a.cols(), 1, b.rows(), factor});
}
void add_transposed_product(double factor, const Eigen::MatrixXd& a, const Eigen::MatrixXd& b, Eigen::MatrixXd& c) {
  HWY_DYNAMIC_DISPATCH(product)
  ({a.data(), b.data(), c.data(), c.rows(), c.cols(), a.cols(), b.rows(), 1, factor});
}

}  // namespace celadon
#endif  // HWY_ONCE
