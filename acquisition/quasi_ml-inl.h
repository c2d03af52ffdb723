// Sub-pixel position of 16 rows at once, one row a SIMD lane: derivative-of-Gaussian zero crossing, then quasi-maximum
// likelihood. Included once for each SIMD target by laser_line_simd.cpp. README.md, "Line extraction", steps 4 and 5.
#if defined(CELADON_QUASI_ML_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CELADON_QUASI_ML_INL_H_
#undef CELADON_QUASI_ML_INL_H_
#else
#define CELADON_QUASI_ML_INL_H_
#endif

#include "acquisition/laser_line_kernels.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace celadon::line_kernels {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using DF = hn::CappedTag<float, kBatchRows>;
using DI = hn::RebindToSigned<DF>;
using DH = hn::Rebind<std::int16_t, DF>;  ///< as many 16-bit lanes as DF has
using DW = hn::CappedTag<std::int16_t, kBatchRows>;
using VF = hn::VFromD<DF>;
using MF = hn::MFromD<DF>;

inline constexpr int kHalf = kWindowPx / 2;
inline constexpr float kSmallestWidth = 0.5f, kLargestWidth = 6.5f;
inline constexpr float kReach = 3.3f;  ///< the model is fitted within this many widths

/// exp(-t) for t >= 0, relative error below 4e-6; 0 beyond 80.
HWY_INLINE VF exp_minus(VF t) {
  const DF d;
  const DI di;
  const auto y = hn::Mul(hn::Min(t, hn::Set(d, 80.f)), hn::Set(d, -1.44269504f));
  const auto whole = hn::Round(y);
  const auto f = hn::Sub(y, whole);
  auto p = hn::MulAdd(f, hn::Set(d, 0.00133336f), hn::Set(d, 0.00961813f));
  p = hn::MulAdd(f, p, hn::Set(d, 0.05550411f));
  p = hn::MulAdd(f, p, hn::Set(d, 0.24022651f));
  p = hn::MulAdd(f, p, hn::Set(d, 0.69314718f));
  p = hn::MulAdd(f, p, hn::Set(d, 1.f));
  const auto exponent = hn::ShiftLeft<23>(hn::Add(hn::ConvertTo(di, whole), hn::Set(di, 127)));
  return hn::Mul(p, hn::BitCast(d, exponent));
}

HWY_INLINE VF load_signal(const Scratch& s, int k, int lane) {
  const DF d;
  return hn::ConvertTo(d, hn::PromoteTo(DI(), hn::Load(DH(), &s.signal[k + kHalf][lane])));
}

/// 1 where the pixel may be used, 0 where it is saturated or outside the frame.
HWY_INLINE VF load_usable(const Scratch& s, int k, int lane) {
  const DF d;
  return hn::Neg(hn::ConvertTo(d, hn::PromoteTo(DI(), hn::Load(DH(), &s.usable[k + kHalf][lane]))));
}

HWY_INLINE VF clamp(VF v, VF low, VF high) {
  return hn::Min(hn::Max(v, low), high);
}

/// Zero crossing of the row's convolution with the derivative of a Gaussian of 3 px (17 taps), the one nearest the
/// coarse peak, into s.x; s.good is 0 where there is none.
HWY_INLINE void zero_crossing(Scratch& s) {
  const DW d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  static constexpr std::int16_t kTaps[8] = {11, 18, 21, 19, 14, 9, 5, 3};  // sum 100: no overflow for -64..255
  for (int lane = 0; lane < kBatchRows; lane += lanes) {
    alignas(64) std::int16_t slope[16][kBatchRows];  // at k = -8 .. 7
    for (int k = -8; k < 8; ++k) {
      auto sum = hn::Zero(d);
      for (int tap = 0; tap < 8; ++tap) {
        const auto right = hn::Load(d, &s.signal[kHalf + k + tap + 1][lane]);
        const auto left = hn::Load(d, &s.signal[kHalf + k - tap - 1][lane]);
        sum = hn::Add(sum, hn::Mul(hn::Sub(right, left), hn::Set(d, kTaps[tap])));
      }
      hn::Store(sum, d, slope[k + 8]);
    }
    // The coarse peak is centred at -0.5: crossings between k and k+1, farthest first, so that the nearest one stays.
    const auto none = hn::Set(d, 100);
    auto at = none, before = hn::Zero(d), after = hn::Zero(d);
    for (int distance = 7; distance >= 0; --distance) {
      for (const int k : {-1 + distance, -1 - distance}) {
        if (k < -8 || k > 6) continue;
        const auto a = hn::Load(d, slope[k + 8]), b = hn::Load(d, slope[k + 9]);
        const auto crosses = hn::AndNot(hn::Gt(b, hn::Zero(d)), hn::Gt(a, hn::Zero(d)));
        at = hn::IfThenElse(crosses, hn::Set(d, static_cast<std::int16_t>(k)), at);
        before = hn::IfThenElse(crosses, a, before);
        after = hn::IfThenElse(crosses, b, after);
      }
    }
    alignas(64) std::int16_t at_row[kBatchRows], before_row[kBatchRows], after_row[kBatchRows];
    hn::Store(at, d, at_row);
    hn::Store(before, d, before_row);
    hn::Store(after, d, after_row);
    for (int i = 0; i < lanes; ++i) {
      const float drop = static_cast<float>(before_row[i]) - static_cast<float>(after_row[i]);
      const bool found = at_row[i] != 100;
      s.x[lane + i] = found ? static_cast<float>(at_row[i]) + static_cast<float>(before_row[i]) / drop : 0.f;
      s.good[lane + i] = found ? 1.f : 0.f;
    }
  }
}

/// What a row's model consists of: A exp(-(k - x)^2 / 2 s^2) + b + slope (k - x_0).
struct LineModel {
  VF x, amplitude, width, background, slope, x_start;
};

/// Noise of one pixel: ambient + shot A g + speckle (A g)^2.
struct NoiseModel {
  VF ambient, shot, speckle;
};

HWY_INLINE VF variance(const NoiseModel& noise, VF light) {
  return hn::MulAdd(light, hn::MulAdd(light, noise.speckle, noise.shot), noise.ambient);
}

/// Smallest and largest value of the lanes, as whole pixels inside the window.
HWY_INLINE int first_pixel(VF v) {
  return HWY_MAX(-kHalf, static_cast<int>(hn::GetLane(hn::MinOfLanes(DF(), v))));
}
HWY_INLINE int last_pixel(VF v) {
  return HWY_MIN(kHalf - 1, static_cast<int>(hn::GetLane(hn::MaxOfLanes(DF(), v))));
}

/// Background from up to 6 pixels on each side beyond `distance` of x; one side alone gives a level without a slope.
template <bool kMasked>
HWY_INLINE void estimate_background(const Scratch& s, int lane, VF distance, LineModel& m) {
  const DF d;
  const auto zero = hn::Zero(d), one = hn::Set(d, 1.f);
  // Within the window, whatever the width.
  const auto near = hn::Min(distance, hn::Sub(hn::Set(d, kHalf - 7.f), hn::Abs(m.x)));
  const auto far = hn::Add(near, hn::Set(d, 6.f));
  struct Side {
    VF mean, distance;
    MF known;
  };
  const auto side = [&](float sign) -> Side {
    auto sum = zero, at = zero, count = zero;
    const auto nearest = hn::MulAdd(hn::Set(d, sign), near, m.x), farthest = hn::MulAdd(hn::Set(d, sign), far, m.x);
    const int first = first_pixel(hn::Min(nearest, farthest)), last = last_pixel(hn::Max(nearest, farthest));
    for (int k = first; k <= last; ++k) {
      const auto offset = hn::Mul(hn::Set(d, sign), hn::Sub(hn::Set(d, static_cast<float>(k)), m.x));
      auto weight = hn::IfThenElseZero(hn::And(hn::Gt(offset, near), hn::Le(offset, far)), one);
      if constexpr (kMasked) weight = hn::Mul(weight, load_usable(s, k, lane));
      sum = hn::MulAdd(weight, load_signal(s, k, lane), sum);
      at = hn::MulAdd(weight, offset, at);
      count = hn::Add(count, weight);
    }
    const auto inverse = hn::Div(one, hn::Max(count, one));
    return {hn::Mul(sum, inverse), hn::Mul(at, inverse), hn::Gt(count, zero)};
  };
  const Side left = side(-1.f), right = side(1.f);
  const auto span = hn::Max(hn::Add(left.distance, right.distance), one);
  m.slope = hn::IfThenElseZero(hn::And(left.known, right.known), hn::Div(hn::Sub(right.mean, left.mean), span));
  const auto l = hn::IfThenElse(left.known, left.mean, right.mean);
  const auto r = hn::IfThenElse(right.known, right.mean, left.mean);
  // The two zones may lie at unequal distances; the level is that at x.
  const auto middle = hn::Mul(hn::Set(d, 0.5f), hn::Sub(right.distance, left.distance));
  m.background = hn::NegMulAdd(m.slope, middle, hn::Mul(hn::Set(d, 0.5f), hn::Add(l, r)));
  m.x_start = m.x;
}

/// Amplitude from the three pixels at x, width from the number of pixels above half of it.
HWY_INLINE void estimate_shape(const Scratch& s, int lane, LineModel& m) {
  const DF d;
  const auto zero = hn::Zero(d), one = hn::Set(d, 1.f);
  auto sum = zero, count = zero;
  for (int k = -10, end = 9; k <= end; ++k) {
    const auto offset = hn::Abs(hn::Sub(hn::Set(d, static_cast<float>(k)), m.x));
    const auto weight = hn::IfThenElseZero(hn::Le(offset, hn::Set(d, 1.5f)), one);
    sum = hn::MulAdd(weight, load_signal(s, k, lane), sum);
    count = hn::Add(count, weight);
  }
  m.amplitude = hn::Max(hn::Sub(hn::Div(sum, hn::Max(count, one)), m.background), one);
  const auto half = hn::MulAdd(hn::Set(d, 0.5f), m.amplitude, m.background);
  auto above = zero;
  for (int k = -18; k < 18; ++k) {
    const auto offset = hn::Sub(hn::Set(d, static_cast<float>(k)), m.x);
    const auto level = hn::NegMulAdd(m.slope, offset, load_signal(s, k, lane));
    const auto counted = hn::And(hn::Gt(level, half), hn::Le(hn::Abs(offset), hn::Set(d, 10.f)));
    above = hn::Add(above, hn::IfThenElseZero(counted, one));
  }
  m.width = clamp(hn::Mul(above, hn::Set(d, 1 / 2.3548f)), hn::Set(d, kSmallestWidth), hn::Set(d, kLargestWidth));
}

/// Sums of a Gauss-Newton step in (x, amplitude, width): information matrix and gradient, by pixels' weights
/// 1/variance.
struct Normal {
  VF xx, xa, xs, aa, as, ss, rx, ra, rs, chi2, count;
};

template <bool kMasked>
HWY_INLINE Normal normal_sums(const Scratch& s, int lane, const LineModel& m, const NoiseModel& noise) {
  const DF d;
  const auto zero = hn::Zero(d), one = hn::Set(d, 1.f);
  Normal n{zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero};
  const auto inverse_width = hn::Div(one, m.width);
  const auto reach = hn::Mul(m.width, hn::Set(d, kReach));
  const auto amplitude_per_width = hn::Mul(m.amplitude, inverse_width);
  const int first = first_pixel(hn::Sub(m.x, reach)), last = last_pixel(hn::Add(m.x, reach));
  for (int k = first; k <= last; ++k) {
    const auto at = hn::Set(d, static_cast<float>(k));
    const auto u = hn::Mul(hn::Sub(at, m.x), inverse_width);
    const auto g = exp_minus(hn::Mul(hn::Mul(u, u), hn::Set(d, 0.5f)));
    const auto light = hn::Mul(m.amplitude, g);
    auto weight = hn::Div(one, variance(noise, light));
    weight = hn::IfThenElseZero(hn::Le(hn::Abs(u), hn::Set(d, kReach)), weight);
    if constexpr (kMasked) weight = hn::Mul(weight, load_usable(s, k, lane));
    const auto by_x = hn::Mul(hn::Mul(amplitude_per_width, g), u);
    const auto by_s = hn::Mul(by_x, u);
    const auto level = hn::MulAdd(m.slope, hn::Sub(at, m.x_start), m.background);
    const auto residual = hn::Sub(hn::Sub(load_signal(s, k, lane), level), light);
    const auto wx = hn::Mul(weight, by_x), wa = hn::Mul(weight, g), ws = hn::Mul(weight, by_s);
    n.xx = hn::MulAdd(wx, by_x, n.xx);
    n.xa = hn::MulAdd(wx, g, n.xa);
    n.xs = hn::MulAdd(wx, by_s, n.xs);
    n.aa = hn::MulAdd(wa, g, n.aa);
    n.as = hn::MulAdd(wa, by_s, n.as);
    n.ss = hn::MulAdd(ws, by_s, n.ss);
    n.rx = hn::MulAdd(wx, residual, n.rx);
    n.ra = hn::MulAdd(wa, residual, n.ra);
    n.rs = hn::MulAdd(ws, residual, n.rs);
    n.chi2 = hn::MulAdd(weight, hn::Mul(residual, residual), n.chi2);
    n.count = hn::Add(n.count, hn::IfThenElseZero(hn::Gt(weight, zero), one));
  }
  return n;
}

/// Inverse of the information matrix: the column of x, and the variance of the amplitude.
struct Inverse {
  VF xx, xa, xs, aa, as, ss;
};

HWY_INLINE Inverse invert(const Normal& n) {
  const DF d;
  const auto xx = hn::MulSub(n.aa, n.ss, hn::Mul(n.as, n.as));
  const auto xa = hn::MulSub(n.xs, n.as, hn::Mul(n.xa, n.ss));
  const auto xs = hn::MulSub(n.xa, n.as, hn::Mul(n.xs, n.aa));
  const auto aa = hn::MulSub(n.xx, n.ss, hn::Mul(n.xs, n.xs));
  const auto as = hn::MulSub(n.xa, n.xs, hn::Mul(n.xx, n.as));
  const auto ss = hn::MulSub(n.xx, n.aa, hn::Mul(n.xa, n.xa));
  const auto determinant = hn::MulAdd(n.xx, xx, hn::MulAdd(n.xa, xa, hn::Mul(n.xs, xs)));
  const auto inverse = hn::Div(hn::Set(d, 1.f), hn::Max(determinant, hn::Set(d, 1e-30f)));
  return {hn::Mul(xx, inverse), hn::Mul(xa, inverse), hn::Mul(xs, inverse),
          hn::Mul(aa, inverse), hn::Mul(as, inverse), hn::Mul(ss, inverse)};
}

/// Refines the rows of the batch in place: s.x, s.sigma, s.amplitude, s.width; s.good is cleared where no line is left.
template <bool kMasked, bool kQuasiMl>
HWY_INLINE void refine_lanes(Scratch& s, int lane, const LaserLineOptions& options) {
  const DF d;
  const auto set = [&](float v) { return hn::Set(d, v); };
  LineModel m;
  m.x = hn::Load(d, s.x + lane);
  auto good = hn::Gt(hn::Load(d, s.good + lane), hn::Zero(d));
  estimate_background<kMasked>(s, lane, set(13.f), m);
  estimate_shape(s, lane, m);
  estimate_background<kMasked>(s, lane, hn::MulAdd(m.width, set(kReach), set(1.f)), m);
  const float speckle = options.speckle_contrast * options.speckle_contrast * options.speckle_extent_px;
  const NoiseModel noise{hn::Load(d, s.ambient_variance + lane), set(1.f / options.electrons_per_level), set(speckle)};
  const auto width_start = m.width;
  const auto x_start = m.x;
  // The width is known to about a third beforehand: that holds faint rows together.
  const auto width_information = hn::Div(set(9.f), hn::Mul(width_start, width_start));
  Normal n;
  Inverse inverse;
  for (int step = 0; step < 4; ++step) {
    n = normal_sums<kMasked>(s, lane, m, noise);
    n.ss = hn::Add(n.ss, width_information);
    n.rs = hn::MulAdd(width_information, hn::Sub(width_start, m.width), n.rs);
    n.aa = hn::MulAdd(n.aa, set(1e-4f), n.aa);
    n.xx = hn::MulAdd(n.xx, set(1e-4f), hn::Add(n.xx, set(1e-6f)));
    inverse = invert(n);
    if (step == 3 || !kQuasiMl) break;
    const auto dx = hn::MulAdd(inverse.xx, n.rx, hn::MulAdd(inverse.xa, n.ra, hn::Mul(inverse.xs, n.rs)));
    const auto da = hn::MulAdd(inverse.xa, n.rx, hn::MulAdd(inverse.aa, n.ra, hn::Mul(inverse.as, n.rs)));
    const auto ds = hn::MulAdd(inverse.xs, n.rx, hn::MulAdd(inverse.as, n.ra, hn::Mul(inverse.ss, n.rs)));
    const auto step_limit = hn::Mul(set(0.6f), m.width);
    m.x = hn::Add(m.x, clamp(dx, hn::Neg(step_limit), step_limit));
    m.amplitude = clamp(hn::Add(m.amplitude, da), hn::Mul(set(0.5f), m.amplitude), hn::Mul(set(2.f), m.amplitude));
    const auto width_limit = hn::Mul(set(0.3f), m.width);
    m.width =
        clamp(hn::Add(m.width, clamp(ds, hn::Neg(width_limit), width_limit)), set(kSmallestWidth), set(kLargestWidth));
  }
  // Gone astray: further from the zero crossing than the two methods can differ on one line.
  good = hn::And(good, hn::Le(hn::Abs(hn::Sub(m.x, x_start)), hn::Max(set(3.f), m.width)));
  // Not a line: light that noise could have made, were position and width known.
  good = hn::And(good, hn::Gt(hn::Mul(hn::Mul(m.amplitude, m.amplitude), n.aa), set(25.f)));
  const auto margin = hn::Mul(set(2.f), m.width);
  good = hn::And(good, hn::Ge(hn::Sub(m.x, margin), hn::Load(d, s.left_limit + lane)));
  good = hn::And(good, hn::Le(hn::Add(m.x, margin), hn::Load(d, s.right_limit + lane)));
  hn::Store(m.x, d, s.x + lane);
  hn::Store(hn::Sqrt(hn::Max(inverse.xx, set(1e-8f))), d, s.sigma + lane);
  hn::Store(m.amplitude, d, s.amplitude + lane);
  hn::Store(m.width, d, s.width + lane);
  hn::Store(hn::IfThenElseZero(good, set(1.f)), d, s.good + lane);
}

template <bool kMasked, bool kQuasiMl>
HWY_INLINE void refine_all(Scratch& s, const LaserLineOptions& options) {
  for (int lane = 0; lane < kBatchRows; lane += static_cast<int>(hn::Lanes(DF()))) {
    refine_lanes<kMasked, kQuasiMl>(s, lane, options);
  }
}

HWY_INLINE void refine(Scratch& s, const LaserLineOptions& options) {
  const bool quasi_ml = options.refinement == LineRefinement::quasi_maximum_likelihood;
  if (s.masked) {
    quasi_ml ? refine_all<true, true>(s, options) : refine_all<true, false>(s, options);
  } else {
    quasi_ml ? refine_all<false, true>(s, options) : refine_all<false, false>(s, options);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace celadon::line_kernels
HWY_AFTER_NAMESPACE();
#endif
