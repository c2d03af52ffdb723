// Compiled once per SIMD target; only additions, products, quotients, square roots and selections, so that every target
// gives the same bits.
#include "daemon/files/polar.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "daemon/files/polar.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef CELADON_FILES_POLAR_ONCE
#define CELADON_FILES_POLAR_ONCE
#include <algorithm>
#include <numbers>

namespace celadon {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double tan_pi_8 = std::numbers::sqrt2 - 1;

/// (atan(t)/t - 1)/t^2 in powers of t^2 for |t| <= tan(pi/8): interpolation at Chebyshev nodes in 60 digits, error of
/// atan(t)/t below 7e-18.
constexpr double coefficient[] = {-0.3333333333333333,  0.1999999999999552,  -0.14285714284666542, 0.11111111015256361,
                                  -0.09090904578123903, 0.07692183190826087, -0.06664511447381948, 0.0585814891280221,
                                  -0.0508544973794026,  0.03923165829558719, -0.01917688711906226};

}  // namespace
}  // namespace celadon
#endif

// Highway's scalar target lacks operations used here and is never needed: the baseline is SSSE3 or NEON at least.
#if HWY_TARGET != HWY_SCALAR
HWY_BEFORE_NAMESPACE();
namespace celadon {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<double>;
using V = hn::Vec<D>;

void polar_of(const double* in_x, const double* in_y, double* out_r, double* out_theta) {
  const D d;
  const V zero = hn::Zero(d);
  const V x = hn::LoadU(d, in_x);
  const V y = hn::LoadU(d, in_y);
  const V ax = hn::Abs(x);
  const V ay = hn::Abs(y);
  const V small = hn::Min(ax, ay);
  const V large = hn::Max(ax, ay);
  // The octant's upper half is turned back by 45 degrees: tan(a - pi/4) = (tan a - 1)/(tan a + 1).
  const auto upper = hn::Gt(small, hn::Mul(hn::Set(d, tan_pi_8), large));
  const V numerator = hn::IfThenElse(upper, hn::Sub(small, large), small);
  const V denominator = hn::IfThenElse(upper, hn::Add(small, large), large);
  const auto off_axis = hn::Gt(large, zero);
  const V t = hn::Div(numerator, hn::IfThenElse(off_axis, denominator, hn::Set(d, 1.0)));
  const V s = hn::Mul(t, t);
  V sum = hn::Set(d, coefficient[10]);
  for (int i = 9; i >= 0; --i) {
    sum = hn::Add(hn::Mul(sum, s), hn::Set(d, coefficient[i]));
  }
  V angle = hn::Add(t, hn::Mul(hn::Mul(t, s), sum));
  angle = hn::Add(hn::IfThenElse(upper, hn::Set(d, pi / 4), zero), angle);
  angle = hn::IfThenElse(hn::Lt(ay, ax), angle, hn::Sub(hn::Set(d, pi / 2), angle));
  angle = hn::IfThenElse(hn::Lt(x, zero), hn::Sub(hn::Set(d, pi), angle), angle);
  angle = hn::IfThenElse(hn::Lt(y, zero), hn::Sub(hn::Set(d, 2 * pi), angle), angle);
  const auto inside = hn::And(off_axis, hn::Lt(angle, hn::Set(d, 2 * pi)));
  hn::StoreU(hn::IfThenElse(inside, angle, zero), d, out_theta);
  hn::StoreU(hn::Sqrt(hn::Add(hn::Mul(x, x), hn::Mul(y, y))), d, out_r);
}

void polar_of_all(const double* x, const double* y, std::size_t n, double* r, double* theta) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t k = 0;
  for (; k + lanes <= n; k += lanes) {
    polar_of(x + k, y + k, r + k, theta + k);
  }
  if (k < n) {
    double tail[4][hn::MaxLanes(D())] = {};
    std::copy(x + k, x + n, tail[0]);
    std::copy(y + k, y + n, tail[1]);
    polar_of(tail[0], tail[1], tail[2], tail[3]);
    std::copy_n(tail[2], n - k, r + k);
    std::copy_n(tail[3], n - k, theta + k);
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon
HWY_AFTER_NAMESPACE();
#endif

#if HWY_ONCE
namespace celadon {

HWY_EXPORT(polar_of_all);

void to_polar(const double* x, const double* y, std::size_t n, double* r, double* theta_rad) {
  HWY_DYNAMIC_DISPATCH(polar_of_all)(x, y, n, r, theta_rad);
}

}  // namespace celadon
#endif
