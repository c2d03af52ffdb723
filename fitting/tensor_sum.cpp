// Compiled once per SIMD target. Lanes are the functions of the u interval; products and sums stay apart and the last
// sum has a fixed order, so that every target gives the same bits.
#include "fitting/tensor_sum.h"

// Arrays of vectors need a fixed vector size.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitting/tensor_sum.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

// Highway's scalar target is never needed: the baseline is SSSE3 or NEON at least.
#if HWY_TARGET != HWY_SCALAR
HWY_BEFORE_NAMESPACE();
namespace celadon {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<double, 4>;
using V = hn::Vec<D>;
constexpr int kLanes = static_cast<int>(hn::MaxLanes(D()));

template <int kWidth>
struct Values {
  static constexpr int kParts = kWidth / kLanes;
  V part[kParts];

  // Horner's rule for all functions of an interval at once.
  HWY_INLINE void set(const IntervalBasis& basis, int interval, double t) {
    const D d;
    const double* row = basis.power(interval) + basis.degree() * kWidth;
    const V s = hn::Set(d, basis.local(interval, t));
    for (int i = 0; i < kParts; ++i) part[i] = hn::LoadU(d, row + i * kLanes);
    for (int k = basis.degree(); k > 0; --k) {
      row -= kWidth;
      for (int i = 0; i < kParts; ++i) part[i] = hn::Add(hn::Mul(part[i], s), hn::LoadU(d, row + i * kLanes));
    }
  }
};

template <int kWidthU, int kWidthV>
void sum(const IntervalBasis& basis_u, const IntervalBasis& basis_v, const Eigen::MatrixXd& coefficients,
         const double* u, const double* v, std::size_t n, double* value) {
  const D d;
  const Eigen::Index stride = coefficients.rows();
  int at_u = 0, at_v = 0;
  bool fresh = true;  // the row has to be made anew
  Values<kWidthU> row, Nu;
  double weight[kWidthV];
  for (std::size_t k = 0; k < n; ++k) {
    const int interval_u = basis_u.locate(u[k], at_u);
    if (fresh || v[k] != v[k - 1]) {
      at_v = basis_v.locate(v[k], at_v);
      Values<kWidthV> Nv;
      Nv.set(basis_v, at_v, v[k]);
      for (int i = 0; i < Nv.kParts; ++i) hn::StoreU(Nv.part[i], d, weight + i * kLanes);
      fresh = true;
    }
    if (fresh || interval_u != at_u) {  // the coefficients along u at this v
      const double* f = coefficients.data() + basis_u.first(interval_u) + basis_v.first(at_v) * stride;
      for (int i = 0; i < row.kParts; ++i) row.part[i] = hn::Mul(hn::Set(d, weight[0]), hn::LoadU(d, f + i * kLanes));
      for (int b = 1; b < kWidthV; ++b) {
        f += stride;
        const V w = hn::Set(d, weight[b]);
        for (int i = 0; i < row.kParts; ++i) {
          row.part[i] = hn::Add(row.part[i], hn::Mul(w, hn::LoadU(d, f + i * kLanes)));
        }
      }
      at_u = interval_u;
      fresh = false;
    }
    Nu.set(basis_u, at_u, u[k]);
    double term[kWidthU];
    for (int i = 0; i < row.kParts; ++i) hn::StoreU(hn::Mul(Nu.part[i], row.part[i]), d, term + i * kLanes);
    double total = (term[0] + term[1]) + (term[2] + term[3]);
    if constexpr (kWidthU == 8) total += (term[4] + term[5]) + (term[6] + term[7]);
    value[k] = total;
  }
}

void sum_of_widths(const IntervalBasis& basis_u, const IntervalBasis& basis_v, const Eigen::MatrixXd& coefficients,
                   const double* u, const double* v, std::size_t n, double* value) {
  const bool wide_u = basis_u.width() == 8, wide_v = basis_v.width() == 8;
  const auto chosen = wide_u ? (wide_v ? &sum<8, 8> : &sum<8, 4>) : (wide_v ? &sum<4, 8> : &sum<4, 4>);
  chosen(basis_u, basis_v, coefficients, u, v, n, value);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon
HWY_AFTER_NAMESPACE();
#endif  // not scalar

#if HWY_ONCE
namespace celadon {
namespace {
HWY_EXPORT(sum_of_widths);
}  // namespace

void tensor_sum(const IntervalBasis& basis_u, const IntervalBasis& basis_v, const Eigen::MatrixXd& coefficients,
                const double* u, const double* v, std::size_t n, double* value) {
  HWY_DYNAMIC_DISPATCH(sum_of_widths)(basis_u, basis_v, coefficients, u, v, n, value);
}

}  // namespace celadon
#endif  // HWY_ONCE
