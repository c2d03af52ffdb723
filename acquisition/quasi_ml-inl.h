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
using DH = hn::Rebind<std::int16_t, DF>;             ///< as many 16-bit lanes as DF has
using DW = hn::CappedTag<std::int16_t, kBatchRows>;  ///< as many rows as fit a vector
using VF = hn::VFromD<DF>;
using VW = hn::VFromD<DW>;

inline constexpr int kMiddle = kWindowPx / 2;  ///< index of pixel k = 0 of the window
inline constexpr int kReachPx = 28;            ///< pixels k = -28 .. 28 are looked at
inline constexpr float kSmallestWidth = 0.5f, kLargestWidth = 6.5f;
inline constexpr float kReachWidths = 3.3f;  ///< the model is fitted within this many widths
inline constexpr int kPasses = 2;            ///< of Gauss-Newton
inline constexpr int kBackgroundPx = 6;      ///< pixels of background on each side

/// Slope of the cut at its pixels -8 .. 7, by 17 taps of the derivative of a Gaussian of 3 px; then the zero crossing
/// nearest the coarse peak (which is centred at -0.5). False if there is none.
HWY_INLINE bool zero_crossing(const std::int16_t* cut, float& x) {
  const DW d;
  constexpr int kCutMiddle = kCutPx / 2;
  static constexpr std::int16_t kTaps[8] = {11, 18, 21, 19, 14, 9, 5, 3};  // sum 100: no overflow for -64..255
  alignas(64) std::int16_t slope[16];
  const int lanes = static_cast<int>(hn::Lanes(d));
  std::uint32_t positive = 0;
  for (int i = 0; i < 16; i += lanes) {
    const std::int16_t* at = cut + kCutMiddle - 8 + i;
    auto sum = hn::Zero(d);
    for (int tap = 1; tap <= 8; ++tap) {
      const auto difference = hn::Sub(hn::LoadU(d, at + tap), hn::LoadU(d, at - tap));
      sum = hn::Add(sum, hn::Mul(difference, hn::Set(d, kTaps[tap - 1])));
    }
    hn::Store(sum, d, slope + i);
    std::uint8_t bits[8] = {};
    hn::StoreMaskBits(d, hn::Gt(sum, hn::Zero(d)), bits);
    positive |= (bits[0] | static_cast<std::uint32_t>(bits[1]) << 8) << i;
  }
  const std::uint32_t crossings = positive & ~(positive >> 1) & 0x7FFF;  // bit i: between i and i + 1
  if (crossings == 0) return false;
  const std::uint32_t right = crossings & 0x7F80, left = crossings & 0x007F;
  int best = right != 0 ? static_cast<int>(hwy::Num0BitsBelowLS1Bit_Nonzero32(right)) : 100;
  if (left != 0) {
    const int nearest_left = 31 - static_cast<int>(hwy::Num0BitsAboveMS1Bit_Nonzero32(left));
    if (7 - nearest_left < best - 7) best = nearest_left;
  }
  const float before = slope[best], after = slope[best + 1];
  x = static_cast<float>(best - 8) + before / (before - after);
  return true;
}

/// out[pixel][row] = in[row][first[row] + pixel], 8 rows and 8 pixels at a time.
HWY_INLINE void transpose_windows(const std::int16_t (*in)[kCutPx], const int* first, std::int16_t (*out)[kBatchRows]) {
  const hn::CappedTag<std::int16_t, 8> d;
  const hn::RepartitionToWide<decltype(d)> d32;
  const hn::RepartitionToWide<decltype(d32)> d64;
  for (int row = 0; row < kBatchRows; row += 8) {
    for (int px = 0; px < kWindowPx; px += 8) {
      const auto load = [&](int i) { return hn::LoadU(d, in[row + i] + first[row + i] + px); };
      const auto low16 = [&](auto a, auto b) { return hn::BitCast(d32, hn::InterleaveLower(d, a, b)); };
      const auto high16 = [&](auto a, auto b) { return hn::BitCast(d32, hn::InterleaveUpper(d, a, b)); };
      const auto low32 = [&](auto a, auto b) { return hn::BitCast(d64, hn::InterleaveLower(d32, a, b)); };
      const auto high32 = [&](auto a, auto b) { return hn::BitCast(d64, hn::InterleaveUpper(d32, a, b)); };
      const auto r0 = load(0), r1 = load(1), r2 = load(2), r3 = load(3);
      const auto r4 = load(4), r5 = load(5), r6 = load(6), r7 = load(7);
      const auto a0 = low16(r0, r1), a1 = low16(r2, r3), a2 = low16(r4, r5), a3 = low16(r6, r7);
      const auto b0 = high16(r0, r1), b1 = high16(r2, r3), b2 = high16(r4, r5), b3 = high16(r6, r7);
      const auto store = [&](int i, auto a, auto b) {
        hn::Store(hn::BitCast(d, hn::InterleaveLower(d64, a, b)), d, out[px + i] + row);
        hn::Store(hn::BitCast(d, hn::InterleaveUpper(d64, a, b)), d, out[px + i + 1] + row);
      };
      store(0, low32(a0, a1), low32(a2, a3));
      store(2, high32(a0, a1), high32(a2, a3));
      store(4, low32(b0, b1), low32(b2, b3));
      store(6, high32(b0, b1), high32(b2, b3));
    }
  }
}

HWY_INLINE VF to_float(hn::VFromD<DH> v) {
  return hn::ConvertTo(DF(), hn::PromoteTo(DI(), v));
}
HWY_INLINE VF load_float(const std::int16_t* p) {
  return to_float(hn::Load(DH(), p));
}
HWY_INLINE VF clamp(VF v, VF low, VF high) {
  return hn::Min(hn::Max(v, low), high);
}

/// What is first known of each row, 16-bit: sums of the background pixels of both sides and of their distances, the
/// light of the three middle pixels, the number of pixels above half of it.
struct Preliminary {
  alignas(64) std::int16_t sum[2][kBatchRows], distance[2][kBatchRows], count[2][kBatchRows];
  alignas(64) std::int16_t near[kBatchRows];  ///< background begins beyond this distance
  alignas(64) std::int16_t half[kBatchRows];  ///< half height
  alignas(64) std::int16_t above[kBatchRows];
};

/// Sums over near < |k| <= near + kBackgroundPx.
template <bool kMasked>
HWY_INLINE void sum_background(const Scratch& s, Preliminary& p) {
  const DW d;
  const auto zero = hn::Zero(d);
  for (int row = 0; row < kBatchRows; row += static_cast<int>(hn::Lanes(d))) {
    const auto near = hn::Load(d, p.near + row), far = hn::Add(near, hn::Set(d, kBackgroundPx));
    VW sum[2] = {zero, zero}, distance[2] = {zero, zero}, count[2] = {zero, zero};
    const int first = hn::GetLane(hn::MinOfLanes(d, near)) + 1, last = hn::GetLane(hn::MaxOfLanes(d, far));
    for (int k = first; k <= last; ++k) {
      const auto at = hn::Set(d, static_cast<std::int16_t>(k));
      const auto inside = hn::VecFromMask(d, hn::AndNot(hn::Gt(at, far), hn::Gt(at, near)));
      for (int side = 0; side < 2; ++side) {
        const int pixel = kMiddle + (side == 0 ? -k : k);
        auto used = inside;
        if constexpr (kMasked) used = hn::And(used, hn::Load(d, s.usable[pixel] + row));
        sum[side] = hn::Add(sum[side], hn::And(used, hn::Load(d, s.signal[pixel] + row)));
        distance[side] = hn::Add(distance[side], hn::And(used, at));
        count[side] = hn::Sub(count[side], used);
      }
    }
    for (int side = 0; side < 2; ++side) {
      hn::Store(sum[side], d, p.sum[side] + row);
      hn::Store(distance[side], d, p.distance[side] + row);
      hn::Store(count[side], d, p.count[side] + row);
    }
  }
}

/// Pixels within 10 of the middle that are above half height.
HWY_INLINE void count_above_half(const Scratch& s, Preliminary& p) {
  const DW d;
  for (int row = 0; row < kBatchRows; row += static_cast<int>(hn::Lanes(d))) {
    const auto half = hn::Load(d, p.half + row);
    auto above = hn::Zero(d);
    for (int k = -10; k <= 10; ++k) {
      above = hn::Sub(above, hn::VecFromMask(d, hn::Gt(hn::Load(d, s.signal[kMiddle + k] + row), half)));
    }
    hn::Store(above, d, p.above + row);
  }
}

/// Line through the means of both sides; one side alone gives a level without a slope.
struct Background {
  VF level, slope, slope_information;  ///< at k = 0; per pixel; 1/variance per 1/variance of a pixel
};

HWY_INLINE Background background_of(const Preliminary& p, int lane) {
  const DF d;
  const auto one = hn::Set(d, 1.f);
  const auto left_count = load_float(p.count[0] + lane), right_count = load_float(p.count[1] + lane);
  const auto left_inverse = hn::Div(one, hn::Max(left_count, one)),
             right_inverse = hn::Div(one, hn::Max(right_count, one));
  const auto left = hn::Mul(load_float(p.sum[0] + lane), left_inverse);
  const auto right = hn::Mul(load_float(p.sum[1] + lane), right_inverse);
  const auto left_at = hn::Mul(load_float(p.distance[0] + lane), left_inverse);
  const auto right_at = hn::Mul(load_float(p.distance[1] + lane), right_inverse);
  const auto has_left = hn::Ge(left_count, one), has_right = hn::Ge(right_count, one);
  const auto both = hn::And(has_left, has_right);
  const auto span = hn::Max(hn::Add(left_at, right_at), one);
  Background b;
  b.slope = hn::IfThenElseZero(both, hn::Div(hn::Sub(right, left), span));
  b.level = hn::IfThenElse(has_left, hn::MulAdd(b.slope, left_at, left), right);
  b.slope_information =
      hn::IfThenElse(both, hn::Div(hn::Mul(span, span), hn::Add(left_inverse, right_inverse)), hn::Set(d, 1e6f));
  return b;
}

/// Noise of one pixel: ambient + shot light + speckle light^2.
struct NoiseModel {
  VF ambient, shot, speckle;
};

/// A row's model: A exp(-(k - x)^2 / 2 s^2) over its background.
struct LineModel {
  VF x, amplitude, width;
};

/// exp(y), relative error below 4e-6, y limited to -80 .. 80.
HWY_INLINE VF exp_of(VF y) {
  const DF d;
  const auto e = hn::Mul(clamp(y, hn::Set(d, -80.f), hn::Set(d, 80.f)), hn::Set(d, 1.44269504f));
  const auto whole = hn::Round(e);
  const auto f = hn::Sub(e, whole);
  auto p = hn::MulAdd(f, hn::Set(d, 0.00133336f), hn::Set(d, 0.00961813f));
  p = hn::MulAdd(f, p, hn::Set(d, 0.05550411f));
  p = hn::MulAdd(f, p, hn::Set(d, 0.24022651f));
  p = hn::MulAdd(f, p, hn::Set(d, 0.69314718f));
  p = hn::MulAdd(f, p, hn::Set(d, 1.f));
  const auto exponent = hn::ShiftLeft<23>(hn::Add(hn::ConvertTo(DI(), whole), hn::Set(DI(), 127)));
  return hn::Mul(p, hn::BitCast(d, exponent));
}

/// Calls f(k, light, u) for k = 0, 1 .. reach and -1 .. -reach with the model's light A g and u = (k - x) / s. The
/// Gaussian follows from its neighbour by two multiplications.
template <class F>
HWY_INLINE void for_each_pixel(const LineModel& m, int reach, F&& f) {
  const DF d;
  const auto inverse_width = hn::Div(hn::Set(d, 1.f), m.width);
  const auto inverse_variance = hn::Mul(inverse_width, inverse_width);
  const auto half = hn::Mul(hn::Set(d, 0.5f), inverse_variance);
  const auto ratio_step = exp_of(hn::Neg(inverse_variance));
  const auto u_start = hn::Neg(hn::Mul(m.x, inverse_width));
  const auto light_start = hn::Mul(m.amplitude, exp_of(hn::Neg(hn::Mul(half, hn::Mul(m.x, m.x)))));
  f(0, light_start, u_start);
  const auto walk = [&](int sign) {
    const auto step = hn::Set(d, static_cast<float>(sign));
    const auto u_step = hn::Mul(step, inverse_width);
    // g(k + sign) / g(k) at k = 0
    auto ratio = exp_of(hn::Mul(half, hn::MulSub(hn::Add(step, step), m.x, hn::Set(d, 1.f))));
    auto light = light_start, u = u_start;
    for (int k = 1; k <= reach; ++k) {
      light = hn::Mul(light, ratio);
      ratio = hn::Mul(ratio, ratio_step);
      u = hn::Add(u, u_step);
      f(sign * k, light, u);
    }
  };
  walk(1);
  walk(-1);
}

HWY_INLINE VF variance(const NoiseModel& noise, VF light) {
  return hn::MulAdd(light, hn::MulAdd(light, noise.speckle, noise.shot), noise.ambient);
}

/// Information and gradient in (x / s, ln A, ln s): derivatives of the light L are L u, L and L u^2.
struct Normal {
  VF aa, xx, ss, rx, ra, rs;  ///< the entry of (ln A, ln s) equals xx
  VF xa, xs;                  ///< zero by symmetry unless pixels are missing
};

template <bool kMasked>
HWY_INLINE Normal normal_sums(const Scratch& s, int lane, const LineModel& m, const Background& b,
                              const NoiseModel& noise) {
  const DF d;
  const auto zero = hn::Zero(d);
  Normal n{zero, zero, zero, zero, zero, zero, zero, zero};
  const auto extent = hn::MulAdd(m.width, hn::Set(d, kReachWidths), hn::Abs(m.x));
  const int reach = HWY_MIN(kReachPx, static_cast<int>(hn::GetLane(hn::MaxOfLanes(d, extent))));
  for_each_pixel(m, reach, [&](int k, VF light, VF u) HWY_ATTR {
    auto t = hn::Div(light, variance(noise, light));  // weight times light
    if constexpr (kMasked) t = hn::Mul(t, hn::Neg(load_float(s.usable[kMiddle + k] + lane)));
    const auto level = hn::MulAdd(b.slope, hn::Set(d, static_cast<float>(k)), b.level);
    const auto residual = hn::Sub(hn::Sub(load_float(s.signal[kMiddle + k] + lane), level), light);
    const auto u2 = hn::Mul(u, u);
    const auto aa = hn::Mul(t, light), xx = hn::Mul(aa, u2);
    n.aa = hn::Add(n.aa, aa);
    n.xx = hn::Add(n.xx, xx);
    n.ss = hn::MulAdd(xx, u2, n.ss);
    const auto ra = hn::Mul(t, residual), rx = hn::Mul(ra, u);
    n.ra = hn::Add(n.ra, ra);
    n.rx = hn::Add(n.rx, rx);
    n.rs = hn::MulAdd(rx, u, n.rs);
    if constexpr (kMasked) {
      n.xa = hn::MulAdd(aa, u, n.xa);
      n.xs = hn::MulAdd(xx, u, n.xs);
    }
  });
  return n;
}

/// Step of Gauss-Newton in (x / s, ln A, ln s) and the variance of x / s.
struct Step {
  VF x, a, s, x_variance;
};

template <bool kMasked>
HWY_INLINE Step solve(const Normal& n) {
  const DF d;
  const auto one = hn::Set(d, 1.f), tiny = hn::Set(d, 1e-20f);
  if constexpr (!kMasked) {
    const auto x_variance = hn::Div(one, n.xx);
    const auto inverse = hn::Div(one, hn::Max(hn::MulSub(n.aa, n.ss, hn::Mul(n.xx, n.xx)), tiny));
    return {hn::Mul(n.rx, x_variance), hn::Mul(inverse, hn::MulSub(n.ss, n.ra, hn::Mul(n.xx, n.rs))),
            hn::Mul(inverse, hn::MulSub(n.aa, n.rs, hn::Mul(n.xx, n.ra))), x_variance};
  } else {
    const auto as = n.xx;
    const auto c_xx = hn::MulSub(n.aa, n.ss, hn::Mul(as, as));
    const auto c_xa = hn::MulSub(n.xs, as, hn::Mul(n.xa, n.ss));
    const auto c_xs = hn::MulSub(n.xa, as, hn::Mul(n.xs, n.aa));
    const auto c_aa = hn::MulSub(n.xx, n.ss, hn::Mul(n.xs, n.xs));
    const auto c_as = hn::MulSub(n.xa, n.xs, hn::Mul(n.xx, as));
    const auto c_ss = hn::MulSub(n.xx, n.aa, hn::Mul(n.xa, n.xa));
    const auto determinant = hn::MulAdd(n.xx, c_xx, hn::MulAdd(n.xa, c_xa, hn::Mul(n.xs, c_xs)));
    const auto inverse = hn::Div(one, hn::Max(determinant, tiny));
    const auto row = [&](VF cx, VF ca, VF cs) {
      return hn::Mul(inverse, hn::MulAdd(cx, n.rx, hn::MulAdd(ca, n.ra, hn::Mul(cs, n.rs))));
    };
    return {row(c_xx, c_xa, c_xs), row(c_xa, c_aa, c_as), row(c_xs, c_as, c_ss), hn::Mul(c_xx, inverse)};
  }
}

/// Variance of the zero crossing by the noise model: (sum h^2 variance) / (sum h dL/dx)^2 with the filter's taps h.
HWY_INLINE VF zero_crossing_variance(const LineModel& m, const NoiseModel& noise) {
  const DF d;
  auto square = hn::Zero(d), response = hn::Zero(d);
  static constexpr float kTaps[9] = {0, 11, 18, 21, 19, 14, 9, 5, 3};
  const auto inverse_width = hn::Div(hn::Set(d, 1.f), m.width);
  for_each_pixel(m, 8, [&](int k, VF light, VF u) HWY_ATTR {
    const auto h = hn::Set(d, k < 0 ? -kTaps[-k] : kTaps[k]);
    square = hn::MulAdd(hn::Mul(h, h), variance(noise, light), square);
    response = hn::MulAdd(hn::Mul(h, light), hn::Mul(u, inverse_width), response);
  });
  return hn::Div(square, hn::Max(hn::Mul(response, response), hn::Set(d, 1e-6f)));
}

/// Refines some rows of the batch in place: s.x, s.sigma, s.amplitude, s.width; s.good is cleared where no line is
/// left.
template <bool kMasked, bool kQuasiMl>
HWY_INLINE void refine_lanes(Scratch& s, const Preliminary& p, int lane, const LaserLineOptions& options) {
  const DF d;
  const auto set = [&](float v) HWY_ATTR { return hn::Set(d, v); };
  const Background b = background_of(p, lane);
  const auto ambient = hn::Load(d, s.ambient_variance + lane);
  const NoiseModel noise{ambient, set(1.f / options.electrons_per_level),
                         set(options.speckle_contrast * options.speckle_contrast * options.speckle_extent_px)};
  const auto x_start = hn::Load(d, s.x + lane);
  const auto light = hn::Add(hn::Add(load_float(s.signal[kMiddle - 1] + lane), load_float(s.signal[kMiddle] + lane)),
                             load_float(s.signal[kMiddle + 1] + lane));
  const auto width_start =
      clamp(hn::Mul(load_float(p.above + lane), set(1 / 2.3548f)), set(kSmallestWidth), set(kLargestWidth));
  LineModel m{x_start, hn::Max(hn::Sub(hn::Mul(light, set(1.f / 3)), b.level), set(1.f)), width_start};
  VF variance_x;
  if constexpr (kQuasiMl) {
    for (int pass = 0; pass < kPasses; ++pass) {
      Normal n = normal_sums<kMasked>(s, lane, m, b, noise);
      // The width is known to about a third beforehand: that holds faint rows together.
      n.ss = hn::Add(n.ss, set(9.f));
      n.rs = hn::MulAdd(set(9.f), hn::Sub(hn::Div(width_start, m.width), set(1.f)), n.rs);
      n.xx = hn::Add(n.xx, set(1e-3f));
      const Step step = solve<kMasked>(n);
      variance_x = hn::Mul(step.x_variance, hn::Mul(m.width, m.width));
      m.x = clamp(hn::MulAdd(m.width, clamp(step.x, set(-0.6f), set(0.6f)), m.x), set(-4.f), set(4.f));
      m.amplitude = hn::MulAdd(m.amplitude, clamp(step.a, set(-0.5f), set(1.f)), m.amplitude);
      m.width = clamp(hn::MulAdd(m.width, clamp(step.s, set(-0.3f), set(0.3f)), m.width), set(kSmallestWidth),
                      set(kLargestWidth));
    }
    // What the background's slope leaves unknown shifts x by 2.83 s^2 / A for each unit of it.
    const auto lever = hn::Div(hn::Mul(set(2.83f), hn::Mul(m.width, m.width)), m.amplitude);
    variance_x = hn::MulAdd(hn::Mul(lever, lever), hn::Div(ambient, b.slope_information), variance_x);
  } else {
    variance_x = zero_crossing_variance(m, noise);
  }
  // Gone astray: further from the zero crossing than the two methods can differ on one line.
  auto good = hn::Le(hn::Abs(hn::Sub(m.x, x_start)), hn::Max(set(3.f), m.width));
  // Not a line: light that noise could have made, were position and width known (speckle makes no light).
  const auto light_information = hn::Div(hn::Mul(hn::Mul(m.amplitude, m.amplitude), hn::Mul(m.width, set(1.7725f))),
                                         hn::MulAdd(noise.shot, m.amplitude, ambient));
  good = hn::And(good, hn::Gt(light_information, set(25.f)));
  hn::Store(m.x, d, s.x + lane);
  hn::Store(hn::Sqrt(variance_x), d, s.sigma + lane);
  hn::Store(m.amplitude, d, s.amplitude + lane);
  hn::Store(m.width, d, s.width + lane);
  hn::Store(hn::IfThenElseZero(good, set(1.f)), d, s.good + lane);
}

template <bool kMasked, bool kQuasiMl>
HWY_INLINE void refine_batch(Scratch& s, const LaserLineOptions& options) {
  const DF d;
  Preliminary p;
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int row = 0; row < kBatchRows; ++row) p.near[row] = 13;
  sum_background<kMasked>(s, p);
  for (int lane = 0; lane < kBatchRows; lane += lanes) {
    const auto level = background_of(p, lane).level;
    const auto light = hn::Add(hn::Add(load_float(s.signal[kMiddle - 1] + lane), load_float(s.signal[kMiddle] + lane)),
                               load_float(s.signal[kMiddle + 1] + lane));
    const auto half = hn::Mul(hn::Set(d, 0.5f), hn::MulAdd(light, hn::Set(d, 1.f / 3), level));
    hn::Store(hn::DemoteTo(DH(), hn::NearestInt(half)), DH(), p.half + lane);
  }
  count_above_half(s, p);
  for (int lane = 0; lane < kBatchRows; lane += lanes) {
    const auto reach = hn::MulAdd(load_float(p.above + lane), hn::Set(d, kReachWidths / 2.3548f), hn::Set(d, 1.f));
    const auto near = clamp(reach, hn::Set(d, 3.f), hn::Set(d, static_cast<float>(kReachPx - kBackgroundPx)));
    hn::Store(hn::DemoteTo(DH(), hn::NearestInt(near)), DH(), p.near + lane);
  }
  sum_background<kMasked>(s, p);
  for (int lane = 0; lane < kBatchRows; lane += lanes) refine_lanes<kMasked, kQuasiMl>(s, p, lane, options);
}

/// Refines the batch in place.
HWY_INLINE void refine(Scratch& s, const LaserLineOptions& options) {
  const bool quasi_ml = options.refinement == LineRefinement::quasi_maximum_likelihood;
  if (s.masked) {
    quasi_ml ? refine_batch<true, true>(s, options) : refine_batch<true, false>(s, options);
  } else {
    quasi_ml ? refine_batch<false, true>(s, options) : refine_batch<false, false>(s, options);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace celadon::line_kernels
HWY_AFTER_NAMESPACE();
#endif
