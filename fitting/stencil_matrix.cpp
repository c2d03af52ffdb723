// The product is compiled once per SIMD target.
#include "fitting/stencil_matrix.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitting/stencil_matrix.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>

// Highway's scalar target is never needed: the baseline is SSSE3 or NEON at least.
#if HWY_TARGET != HWY_SCALAR
HWY_BEFORE_NAMESPACE();
namespace celadon {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<double>;
using V = hn::Vec<D>;

// Elements [i, i + kVectors vectors) of row j: sums over all planes stay in registers.
template <int kVectors>
HWY_INLINE void row_part(const StencilMatrix& m, const double* x, double* y, int j, int i) {
  const D d;
  const auto lanes = static_cast<std::ptrdiff_t>(hn::Lanes(d));
  const int band = m.band_u();
  V sum[kVectors];
  for (int k = 0; k < kVectors; ++k) sum[k] = hn::Zero(d);
  for (int o = 0; o < m.planes_v(); ++o) {
    const double* from = x + m.at(i, m.neighbour(j, o)) - band;
    const double* a = m.plane(o, -band) + m.at(i, j);
    for (int offset = 0; offset <= 2 * band; ++offset, a += m.field_size(), ++from)
      for (int k = 0; k < kVectors; ++k)
        sum[k] = hn::MulAdd(hn::LoadU(d, a + k * lanes), hn::LoadU(d, from + k * lanes), sum[k]);
  }
  for (int k = 0; k < kVectors; ++k) hn::StoreU(sum[k], d, y + m.at(i, j) + k * lanes);
}

void multiply_fields(const StencilMatrix& m, const double* x, double* y) {
  const int n = m.count_u(), lanes = static_cast<int>(hn::Lanes(D()));
  for (int j = 0; j < m.count_v(); ++j) {
    if (n < lanes) {
      for (int i = 0; i < n; ++i) {
        double sum = 0;
        for (int o = 0; o < m.planes_v(); ++o)
          for (int offset = -m.band_u(); offset <= m.band_u(); ++offset)
            sum += m.plane(o, offset)[m.at(i, j)] * x[m.at(i + offset, m.neighbour(j, o))];
        y[m.at(i, j)] = sum;
      }
      continue;
    }
    int i = 0;
    for (; i + 4 * lanes <= n; i += 4 * lanes) row_part<4>(m, x, y, j, i);
    for (; i + lanes <= n; i += lanes) row_part<1>(m, x, y, j, i);
    if (i < n) row_part<1>(m, x, y, j, n - lanes);  // some twice, with the same result
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon
HWY_AFTER_NAMESPACE();
#endif  // not scalar

#if HWY_ONCE
namespace celadon {
namespace {
HWY_EXPORT(multiply_fields);
}  // namespace

StencilMatrix::StencilMatrix(int count_u, int band_u, int count_v, int band_v)
    : count_u_(count_u),
      band_u_(band_u),
      count_v_(count_v),
      band_v_(band_v),
      planes_v_(std::min(2 * band_v + 1, count_v)),
      pitch_((count_u + 2 * band_u + 3) / 4 * 4) {
  entries_.assign(static_cast<std::size_t>(planes_v_ * (2 * band_u_ + 1)) * field_size(), 0.0);
}

int StencilMatrix::neighbour(int j, int plane) const {
  const int k = planes_v_ == count_v_ ? j + plane : j + plane - band_v_;
  return k < 0 ? k + count_v_ : (k >= count_v_ ? k - count_v_ : k);
}

int StencilMatrix::plane_of(int j, int k) const {
  int d = k - j;
  if (planes_v_ == count_v_) return d < 0 ? d + count_v_ : d;
  if (d > band_v_) d -= count_v_;
  if (d < -band_v_) d += count_v_;
  return d + band_v_;
}

void StencilMatrix::multiply(const double* x, double* y) const {
  std::fill(y, y + field_size(), 0.0);
  HWY_DYNAMIC_DISPATCH(multiply_fields)(*this, x, y);
}

void StencilMatrix::scale(double factor) {
  for (double& entry : entries_) entry *= factor;
}

void StencilMatrix::scale_both_sides(const Eigen::MatrixXd& d) {
  for (int o = 0; o < planes_v_; ++o)
    for (int du = -band_u_; du <= band_u_; ++du)
      for (int j = 0; j < count_v_; ++j)
        for (int i = std::max(0, -du); i < std::min(count_u_, count_u_ - du); ++i)
          plane(o, du)[at(i, j)] *= d(i, j) * d(i + du, neighbour(j, o));
}

void StencilMatrix::add(const StencilMatrix& b, double factor) {
  for (std::size_t k = 0; k < entries_.size(); ++k) entries_[k] += factor * b.entries_[k];
}

void StencilMatrix::add_product(const Eigen::MatrixXd& g) {
  for (int o = 0; o < planes_v_; ++o)
    for (int du = -band_u_; du <= band_u_; ++du)
      for (int j = 0; j < count_v_; ++j)
        for (int i = std::max(0, -du); i < std::min(count_u_, count_u_ - du); ++i)
          plane(o, du)[at(i, j)] += g.col(j * count_u_ + i).dot(g.col(neighbour(j, o) * count_u_ + i + du));
}

}  // namespace celadon
#endif  // HWY_ONCE
