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

/// At most 256 bits: a core that meets longer vectors once a frame wakes their upper halves each time, which costs half
/// of what the frame takes.
using DF = hn::CappedTag<float, 8>;
using DI = hn::RebindToSigned<DF>;
using DH = hn::Rebind<std::int16_t, DF>;             ///< as many 16-bit lanes as DF has
using DW = hn::CappedTag<std::int16_t, kBlockRows>;  ///< as many rows as fit a vector
using VF = hn::VFromD<DF>;
using VW = hn::VFromD<DW>;

inline constexpr int kMiddle = kWindowPx / 2;  ///< index of pixel k = 0 of the window
inline constexpr int kReachPx = 28;            ///< pixels k = -28 .. 28 are looked at
inline constexpr float kSmallestWidth = 0.5f, kLargestWidth = 6.5f;
inline constexpr float kReachWidths = 3.3f;            ///< the model is fitted within this many widths
inline constexpr float kWidthPerHeight = 1 / 2.3548f;  ///< standard deviation per full width at half height
inline constexpr int kBackgroundPx = 6;                ///< pixels of background on each side
/// Passes of Gauss-Newton; more where a flat top hides the amplitude.
template <bool kMasked>
constexpr int kPasses = kMasked ? 6 : 3;

/// The width is known to about a seventh beforehand: that holds faint and speckled rows together.
inline constexpr float kWidthInformation = 50;

/// Derivative of a Gaussian of 3 px, positive half. Sum 100: no overflow for -64..255.
inline constexpr std::int16_t kTaps[9] = {0, 11, 18, 21, 19, 14, 9, 5, 3};

HWY_INLINE VF to_float(hn::VFromD<DH> v) {
  return hn::ConvertTo(DF(), hn::PromoteTo(DI(), v));
}
HWY_INLINE VF load_float(const std::int16_t* p) {
  return to_float(hn::Load(DH(), p));
}
HWY_INLINE VF clamp(VF v, VF low, VF high) {
  return hn::Min(hn::Max(v, low), high);
}

/// What is first known of each row, 16-bit.
struct Preliminary {
  alignas(64) std::int16_t before[kBlockRows], after[kBlockRows];  ///< slopes on both sides of the zero crossing
  alignas(64) std::int16_t crossing[kBlockRows];  ///< the pixel before it, -6 .. 4; kNoCrossing if there is none
  alignas(64) std::int16_t light[kBlockRows];     ///< sum of the three pixels about it
  alignas(64) std::int16_t near[kBlockRows];      ///< background begins beyond this distance
  alignas(64) std::int16_t sum[2][kBlockRows], distance[2][kBlockRows], count[2][kBlockRows];  ///< background by side
  alignas(64) std::int16_t half[kBlockRows];                                                   ///< half height
  alignas(64) std::int16_t above[kBlockRows], moment[kBlockRows];  ///< pixels above it: count and sum of k
  alignas(64) std::int16_t flat[kBlockRows];                       ///< those of them that cannot be used
};
inline constexpr std::int16_t kNoCrossing = 100;

/// Zero crossing nearest the middle of the convolution with the derivative of a Gaussian, at pixels -6 .. 5.
HWY_INLINE void find_crossings(const Scratch& s, Preliminary& p) {
  const DW d;
  for (int row = 0; row < kBlockRows; row += static_cast<int>(hn::Lanes(d))) {
    const auto at = [&](int k) HWY_ATTR { return hn::Load(d, s.signal[kMiddle + k] + row); };
    const auto slope_at = [&](int k) HWY_ATTR {
      auto sum = hn::Zero(d);
      for (int tap = 1; tap <= 8; ++tap) {
        sum = hn::Add(sum, hn::Mul(hn::Sub(at(k + tap), at(k - tap)), hn::Set(d, kTaps[tap])));
      }
      return sum;
    };
    const auto zero = hn::Zero(d);
    auto before = zero, after = zero, crossing = hn::Set(d, kNoCrossing), light = zero;
    auto distance = hn::Set(d, kNoCrossing);
    auto right = slope_at(5);
    for (int k = 4; k >= -6; --k) {  // from the right: at equal distance the right one is kept
      const auto left = slope_at(k);
      const auto here = hn::Set(d, static_cast<std::int16_t>(2 * k + 1 < 0 ? -2 * k - 1 : 2 * k + 1));
      const auto nearer = hn::And(hn::Lt(here, distance), hn::AndNot(hn::Gt(right, zero), hn::Gt(left, zero)));
      const auto sum =
          hn::Add(hn::Add(at(k), at(k + 1)), hn::IfThenElse(hn::Gt(hn::Add(left, right), zero), at(k + 2), at(k - 1)));
      distance = hn::IfThenElse(nearer, here, distance);
      before = hn::IfThenElse(nearer, left, before);
      after = hn::IfThenElse(nearer, right, after);
      crossing = hn::IfThenElse(nearer, hn::Set(d, static_cast<std::int16_t>(k)), crossing);
      light = hn::IfThenElse(nearer, sum, light);
      right = left;
    }
    hn::Store(before, d, p.before + row);
    hn::Store(after, d, p.after + row);
    hn::Store(crossing, d, p.crossing + row);
    hn::Store(light, d, p.light + row);
  }
}

/// A flat top has no zero crossing to be trusted: in its place three times the largest signal near the middle.
HWY_INLINE void find_tops(const Scratch& s, Preliminary& p) {
  const DW d;
  for (int row = 0; row < kBlockRows; row += static_cast<int>(hn::Lanes(d))) {
    auto top = hn::Zero(d);
    for (int k = -4; k <= 4; ++k) top = hn::Max(top, hn::Load(d, s.signal[kMiddle + k] + row));
    hn::Store(hn::Add(top, hn::Add(top, top)), d, p.light + row);
    hn::Store(hn::Zero(d), d, p.before + row);
    hn::Store(hn::Zero(d), d, p.after + row);
    hn::Store(hn::Zero(d), d, p.crossing + row);
  }
}

/// Sums over near < |k| <= near + kBackgroundPx.
template <bool kMasked>
HWY_INLINE void sum_background(const Scratch& s, Preliminary& p) {
  const DW d;
  const auto zero = hn::Zero(d);
  for (int row = 0; row < kBlockRows; row += static_cast<int>(hn::Lanes(d))) {
    const auto near = hn::Load(d, p.near + row), far = hn::Add(near, hn::Set(d, kBackgroundPx));
    VW sum[2] = {zero, zero}, distance[2] = {zero, zero}, count[2] = {zero, zero};
    const int first = hn::GetLane(hn::MinOfLanes(d, near)) + 1, last = hn::GetLane(hn::MaxOfLanes(d, far));
    for (int k = first; k <= last; ++k) {
      const auto at = hn::Set(d, static_cast<std::int16_t>(k));
      const auto inside = hn::VecFromMask(d, hn::AndNot(hn::Gt(at, far), hn::Gt(at, near)));
      for (int side = 0; side < 2; ++side) {
        const int pixel = kMiddle + (side == 0 ? -k : k);
        auto used = inside;
        if constexpr (kMasked) used = hn::And(used, hn::Load(d, s.usable_signal[pixel] + row));
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

/// Pixels about the middle that are above half height.
template <bool kMasked>
HWY_INLINE void count_above_half(const Scratch& s, Preliminary& p) {
  constexpr int kFar = kMasked ? 20 : 10;
  const DW d;
  for (int row = 0; row < kBlockRows; row += static_cast<int>(hn::Lanes(d))) {
    const auto half = hn::Load(d, p.half + row);
    auto above = hn::Zero(d), moment = hn::Zero(d), flat = hn::Zero(d);
    for (int k = -kFar; k <= kFar; ++k) {
      const auto is_above = hn::VecFromMask(d, hn::Gt(hn::Load(d, s.signal[kMiddle + k] + row), half));
      above = hn::Sub(above, is_above);
      moment = hn::Add(moment, hn::And(is_above, hn::Set(d, static_cast<std::int16_t>(k))));
      if constexpr (kMasked) {
        flat = hn::Sub(flat, hn::AndNot(hn::Load(d, s.usable_signal[kMiddle + k] + row), is_above));
      }
    }
    hn::Store(above, d, p.above + row);
    hn::Store(moment, d, p.moment + row);
    hn::Store(flat, d, p.flat + row);
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
  const auto slope = hn::IfThenElseZero(both, hn::Div(hn::Sub(right, left), span));
  // Whole at once: g++ compiles a default constructor without this target's instructions, and NEON's vectors need them.
  return {hn::IfThenElse(has_left, hn::MulAdd(slope, left_at, left), right), slope,
          hn::IfThenElse(both, hn::Div(hn::Mul(span, span), hn::Add(left_inverse, right_inverse)), hn::Set(d, 1e6f))};
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

/// Calls f(k, light, u) for k = 0, 1, -1 .. reach, -reach with the model's light A g and u = (k - x) / s. The Gaussian
/// follows from its neighbour by two multiplications.
template <class F>
HWY_INLINE void for_each_pixel(const LineModel& m, int reach, F&& f) {
  const DF d;
  const auto set = [&](float v) HWY_ATTR { return hn::Set(d, v); };
  const auto inverse_width = hn::Div(set(1.f), m.width);
  const auto inverse_variance = hn::Mul(inverse_width, inverse_width);
  const auto half = hn::Mul(set(0.5f), inverse_variance);
  const auto ratio_step = exp_of(hn::Neg(inverse_variance));
  const auto light = hn::Mul(m.amplitude, exp_of(hn::Neg(hn::Mul(half, hn::Mul(m.x, m.x)))));
  const auto u = hn::Neg(hn::Mul(m.x, inverse_width)), twice_x = hn::Add(m.x, m.x);
  f(0, light, u);
  // g(k + 1) / g(k) and g(-k - 1) / g(-k), from k = 0
  auto ratio_right = exp_of(hn::Mul(half, hn::Sub(twice_x, set(1.f))));
  auto ratio_left = exp_of(hn::Neg(hn::Mul(half, hn::Add(twice_x, set(1.f)))));
  auto light_right = light, light_left = light, u_right = u, u_left = u;
  for (int k = 1; k <= reach; ++k) {
    light_right = hn::Mul(light_right, ratio_right);
    ratio_right = hn::Mul(ratio_right, ratio_step);
    u_right = hn::Add(u_right, inverse_width);
    f(k, light_right, u_right);
    light_left = hn::Mul(light_left, ratio_left);
    ratio_left = hn::Mul(ratio_left, ratio_step);
    u_left = hn::Sub(u_left, inverse_width);
    f(-k, light_left, u_left);
  }
}

HWY_INLINE VF variance(const NoiseModel& noise, VF light) {
  return hn::MulAdd(light, hn::MulAdd(light, noise.speckle, noise.shot), noise.ambient);
}

/// Passes of Gauss-Newton: weights need not be exact before the last.
enum class Pass : std::uint8_t { first, tells_speckle, last };

/// Information and gradient in (x / s, ln A, ln s): derivatives of the light L are L u, L and L u^2. With p the
/// information of a pixel on ln A, and z its residual over its noise: sums of p (z^2 - 1) and of p^2.
struct Normal {
  VF aa, xx, ss, rx, ra, rs;  ///< the entry of (ln A, ln s) equals xx
  VF xa, xs;                  ///< zero by symmetry unless pixels are missing
  VF excess, weight;
};

/// Signal over background of the vector of rows from `lane` on, at pixels up to `reach` from the middle; what is there
/// already stays.
HWY_INLINE void subtract_background(Scratch& s, int lane, int reach) {
  const DF d;
  const auto level = hn::Load(d, s.level + lane), slope = hn::Load(d, s.slope + lane);
  const auto subtract = [&](int k) HWY_ATTR {
    const auto background = hn::MulAdd(slope, hn::Set(d, static_cast<float>(k)), level);
    hn::Store(hn::Sub(load_float(s.signal[kMiddle + k] + lane), background), d, s.light[kMiddle + k] + lane);
  };
  for (int k = s.light_reach[lane] + 1; k <= reach; ++k) {
    subtract(k);
    subtract(-k);
  }
  s.light_reach[lane] = HWY_MAX(s.light_reach[lane], reach);
}

/// 1 / v to 11 bits and more: weights need no better.
HWY_INLINE VF reciprocal_of(VF v) {
  const auto r = hn::ApproximateReciprocal(v);
#if HWY_ARCH_ARM  // NEON's estimate has 8 bits: a step of Newton's method doubles them
  return hn::Mul(r, hn::NegMulAdd(v, r, hn::Set(DF(), 2.f)));
#else
  return r;
#endif
}

template <bool kMasked, Pass kPass>
HWY_INLINE Normal normal_sums(Scratch& s, int lane, const LineModel& m, const NoiseModel& noise) {
  const DF d;
  const auto zero = hn::Zero(d), reach2 = hn::Set(d, kReachWidths * kReachWidths);
  Normal n{zero, zero, zero, zero, zero, zero, zero, zero, zero, zero};
  const auto extent = hn::MulAdd(m.width, hn::Set(d, kReachWidths), hn::Abs(m.x));
  const int reach = HWY_MIN(kReachPx, static_cast<int>(hn::GetLane(hn::MaxOfLanes(d, extent))));
  subtract_background(s, lane, reach);
  for_each_pixel(
      m, reach, [&](int k, VF light, VF u) HWY_ATTR __attribute__((always_inline)) {
        const auto u2 = hn::Mul(u, u);
        const auto v = variance(noise, light);
        auto t = kPass == Pass::last ? hn::Div(light, v) : hn::Mul(light, reciprocal_of(v));
        t = hn::IfThenElseZero(hn::Le(u2, reach2), t);  // weight times light
        if constexpr (kMasked) t = hn::Mul(t, hn::Neg(load_float(s.usable_signal[kMiddle + k] + lane)));
        const auto residual = hn::Sub(hn::Load(d, s.light[kMiddle + k] + lane), light);
        const auto aa = hn::Mul(t, light), xx = hn::Mul(aa, u2);
        n.aa = hn::Add(n.aa, aa);
        n.xx = hn::Add(n.xx, xx);
        n.ss = hn::MulAdd(xx, u2, n.ss);
        const auto ra = hn::Mul(t, residual), rx = hn::Mul(ra, u);
        n.ra = hn::Add(n.ra, ra);
        n.rx = hn::Add(n.rx, rx);
        n.rs = hn::MulAdd(rx, u, n.rs);
        if constexpr (kPass == Pass::tells_speckle) {
          n.excess = hn::MulAdd(ra, ra, n.excess);
          n.weight = hn::MulAdd(aa, aa, n.weight);
        }
        if constexpr (kMasked) {
          n.xa = hn::MulAdd(aa, u, n.xa);
          n.xs = hn::MulAdd(xx, u, n.xs);
        }
      });
  n.excess = hn::Sub(n.excess, n.aa);
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

/// Variance of the zero crossing by the noise model: (sum h^2 V) / (sum h dL/dx)^2 with the filter h = k exp(-k^2 /
/// 18), its sums as integrals of Gaussians.
HWY_INLINE VF zero_crossing_variance(const LineModel& m, const NoiseModel& noise) {
  const DF d;
  const auto set = [&](float v) HWY_ATTR { return hn::Set(d, v); };
  const auto width2 = hn::Mul(m.width, m.width), sharpness = hn::Div(set(1.f), width2);
  // integral of k^2 exp(-a k^2), over sqrt(pi) / 2
  const auto moment = [&](VF a) HWY_ATTR { return hn::Div(set(1.f), hn::Mul(a, hn::Sqrt(a))); };
  const auto shot = moment(hn::MulAdd(set(0.5f), sharpness, set(1.f / 9)));
  const auto speckle = moment(hn::Add(sharpness, set(1.f / 9)));
  const auto response =
      hn::Mul(hn::Mul(m.amplitude, sharpness), moment(hn::MulAdd(set(0.5f), sharpness, set(1.f / 18))));
  const auto light = hn::MulAdd(hn::Mul(m.amplitude, speckle), noise.speckle, hn::Mul(shot, noise.shot));
  const auto square = hn::MulAdd(m.amplitude, light, hn::Mul(set(27.f), noise.ambient));
  return hn::Div(hn::Mul(square, set(1.1283792f)), hn::Mul(response, response));
}

/// Level, start and width of each row, from sums of 16-bit pixels.
template <bool kMasked>
HWY_INLINE void prepare(Scratch& s, bool quasi_ml) {
  const DF d;
  Preliminary p;
  const auto set = [&](float v) HWY_ATTR { return hn::Set(d, v); };
  const int lanes = static_cast<int>(hn::Lanes(d));
  if constexpr (kMasked) {
    find_tops(s, p);
  } else {
    find_crossings(s, p);
  }
  for (int row = 0; row < kBlockRows; ++row) p.near[row] = 13;
  sum_background<kMasked>(s, p);
  for (int lane = 0; lane < kBlockRows; lane += lanes) {
    const auto light = hn::MulAdd(load_float(p.light + lane), set(1.f / 3), background_of(p, lane).level);
    // Away from ties, so that every target rounds alike.
    const auto half = hn::MulSub(set(0.5f), light, set(0.29f));
    hn::Store(hn::DemoteTo(DH(), hn::NearestInt(half)), DH(), p.half + lane);
  }
  count_above_half<kMasked>(s, p);
  for (int lane = 0; lane < kBlockRows; lane += lanes) {
    const auto before = load_float(p.before + lane), after = load_float(p.after + lane);
    const auto above = load_float(p.above + lane), crossing = load_float(p.crossing + lane);
    auto x = hn::Add(crossing, hn::Div(before, hn::Max(hn::Sub(before, after), set(1.f))));
    auto good = hn::Lt(crossing, set(static_cast<float>(kNoCrossing)));
    auto width = hn::Mul(above, set(kWidthPerHeight));
    auto growth = set(1.f);
    const auto middle = hn::Div(load_float(p.moment + lane), hn::Max(above, set(1.f)));
    if (kMasked || quasi_ml) x = middle;
    if constexpr (kMasked) {  // the ends of a flat top tell width and amplitude
      good = hn::Gt(above, hn::Zero(d));
      const auto flat = load_float(p.flat + lane), flat2 = hn::Mul(flat, flat);
      // The counts are whole: at least one pixel of the flanks is above half height.
      const auto width2 = hn::Mul(hn::Max(hn::MulSub(above, above, flat2), hn::Add(above, above)),
                                  set(kWidthPerHeight * kWidthPerHeight));
      width = hn::Sqrt(width2);
      growth = exp_of(hn::Min(hn::Div(flat2, hn::Mul(set(8.f), width2)), set(4.f)));
    }
    x = clamp(x, set(-10.f), set(10.f));
    width = clamp(width, set(kSmallestWidth), set(kLargestWidth));
    const auto near = clamp(hn::Add(hn::MulAdd(width, set(kReachWidths), set(1.f)), hn::Abs(x)), set(3.f),
                            set(static_cast<float>(kReachPx - kBackgroundPx)));
    hn::Store(hn::DemoteTo(DH(), hn::NearestInt(near)), DH(), p.near + lane);
    hn::Store(x, d, s.x_start + lane);
    hn::Store(x, d, s.x + lane);
    hn::Store(width, d, s.width_start + lane);
    hn::Store(width, d, s.width + lane);
    hn::Store(growth, d, s.amplitude + lane);
    hn::Store(hn::IfThenElseZero(good, set(1.f)), d, s.good + lane);
  }
  sum_background<kMasked>(s, p);
  for (int lane = 0; lane < kBlockRows; lane += lanes) {
    const Background b = background_of(p, lane);
    const auto light = hn::Sub(hn::Mul(load_float(p.light + lane), set(1.f / 3)), b.level);
    s.light_reach[lane] = -1;
    hn::Store(b.level, d, s.level + lane);
    hn::Store(b.slope, d, s.slope + lane);
    hn::Store(b.slope_information, d, s.slope_information + lane);
    hn::Store(hn::Mul(hn::Load(d, s.amplitude + lane), hn::Max(light, set(1.f))), d, s.amplitude + lane);
  }
}

HWY_INLINE NoiseModel noise_of(const Scratch& s, int lane, const LaserLineOptions& options, float speckle) {
  const DF d;
  return {hn::Load(d, s.ambient_variance + lane), hn::Set(d, 1 / options.electrons_per_level), hn::Set(d, speckle)};
}

HWY_INLINE LineModel model_of(const Scratch& s, int lane) {
  const DF d;
  return {hn::Load(d, s.x + lane), hn::Load(d, s.amplitude + lane), hn::Load(d, s.width + lane)};
}

template <bool kMasked>
constexpr WindowKind kKind = kMasked ? WindowKind::partial : WindowKind::whole;

/// Whether a vector of rows from `lane` on holds one of this kind.
template <bool kMasked>
HWY_INLINE bool has_rows(const Scratch& s, int lane) {
  bool has = false;
  for (std::size_t i = 0; i < hn::Lanes(DF()); ++i) {
    has = has || s.kind[static_cast<std::size_t>(lane) + i] == kKind<kMasked>;
  }
  return has;
}

/// One pass of Gauss-Newton over the block, and what each row says of the speckle.
template <bool kMasked, Pass kPass>
HWY_NOINLINE void improve(Scratch& s, const LaserLineOptions& options, float speckle) {
  const DF d;
  const auto set = [&](float v) HWY_ATTR { return hn::Set(d, v); };
  for (int lane = 0; lane < kBlockRows; lane += static_cast<int>(hn::Lanes(d))) {
    if (!has_rows<kMasked>(s, lane)) continue;
    LineModel m = model_of(s, lane);
    Normal n = normal_sums<kMasked, kPass>(s, lane, m, noise_of(s, lane, options, speckle));
    if constexpr (kPass == Pass::tells_speckle) {  // position, amplitude and width take up a share of the noise
      const auto taken = hn::Div(hn::Mul(set(3.f), n.weight), hn::Max(n.aa, set(1e-6f)));
      hn::Store(hn::Add(n.excess, taken), d, s.speckle_excess + lane);
      hn::Store(n.weight, d, s.speckle_weight + lane);
    }
    n.ss = hn::Add(n.ss, set(kWidthInformation));
    n.rs = hn::MulAdd(set(kWidthInformation), hn::Sub(hn::Div(hn::Load(d, s.width_start + lane), m.width), set(1.f)),
                      n.rs);
    n.xx = hn::Add(n.xx, set(1e-3f));
    const Step step = solve<kMasked>(n);
    hn::Store(hn::Mul(step.x_variance, hn::Mul(m.width, m.width)), d, s.variance_x + lane);
    m.x = clamp(hn::MulAdd(m.width, clamp(step.x, set(-0.6f), set(0.6f)), m.x), set(-12.f), set(12.f));
    m.amplitude = hn::MulAdd(m.amplitude, clamp(step.a, set(-0.5f), set(1.f)), m.amplitude);
    m.width = clamp(hn::MulAdd(m.width, clamp(step.s, set(-0.3f), set(0.3f)), m.width), set(kSmallestWidth),
                    set(kLargestWidth));
    hn::Store(m.x, d, s.x + lane);
    hn::Store(m.amplitude, d, s.amplitude + lane);
    hn::Store(m.width, d, s.width + lane);
  }
}

/// Speckle (variance over squared light, times its extent) that the rows of this kind show; the options count for one
/// row.
HWY_INLINE float pooled_speckle(const Scratch& s, WindowKind kind, const LaserLineOptions& options, float assumed) {
  const float expected = options.speckle_contrast * options.speckle_contrast * options.speckle_extent_px;
  float excess = 0, weight = 0, rows = 0;
  for (int i = 0; i < kBlockRows; ++i) {
    if (s.kind[i] != kind || !(s.good[i] > 0)) continue;
    excess += s.speckle_excess[i];
    weight += s.speckle_weight[i];
    ++rows;
  }
  if (!(weight > 0)) return expected;
  const float shown = options.speckle_extent_px * HWY_MAX(assumed + excess / weight, 0.f);
  return (rows * HWY_MIN(shown, 1.f) + expected) / (rows + 1);
}

/// Widths change slowly along a line: each row begins half way between what it shows alone and the mean of its block.
HWY_INLINE void pool_widths(Scratch& s, WindowKind kind) {
  float sum = 0, rows = 0;
  for (int i = 0; i < kBlockRows; ++i) {
    if (s.kind[i] != kind || !(s.good[i] > 0)) continue;
    sum += s.width_start[i];
    ++rows;
  }
  const float mean = sum / HWY_MAX(rows, 1.f);
  for (int i = 0; i < kBlockRows; ++i) {
    s.width_start[i] = 0.5f * (s.width_start[i] + mean);
    s.width[i] = s.width_start[i];
  }
}

/// Refines the rows of the block that are of one kind, in place; s.good is cleared where no line is left.
template <bool kMasked>
HWY_INLINE void refine_block(Scratch& s, const LaserLineOptions& options) {
  const DF d;
  const auto set = [&](float v) HWY_ATTR { return hn::Set(d, v); };
  const bool quasi_ml = options.refinement == LineRefinement::quasi_maximum_likelihood;
  float speckle = options.speckle_contrast * options.speckle_contrast * options.speckle_extent_px;
  prepare<kMasked>(s, quasi_ml);
  pool_widths(s, kKind<kMasked>);
  if (quasi_ml) {
    for (int pass = 2; pass < kPasses<kMasked>; ++pass) improve<kMasked, Pass::first>(s, options, speckle);
    improve<kMasked, Pass::tells_speckle>(s, options, speckle);
    speckle = pooled_speckle(s, kKind<kMasked>, options, speckle);
    improve<kMasked, Pass::last>(s, options, speckle);
  }
  for (int lane = 0; lane < kBlockRows; lane += static_cast<int>(hn::Lanes(d))) {
    const LineModel m = model_of(s, lane);
    const NoiseModel noise = noise_of(s, lane, options, speckle);
    auto variance_x = hn::Load(d, s.variance_x + lane);
    if (quasi_ml) {
      // What the background's slope leaves unknown shifts x by 2.83 s^2 / A for each unit of it.
      const auto lever = hn::Div(hn::Mul(set(2.83f), hn::Mul(m.width, m.width)), m.amplitude);
      variance_x = hn::MulAdd(hn::Mul(lever, lever), hn::Div(noise.ambient, hn::Load(d, s.slope_information + lane)),
                              variance_x);
    } else {
      variance_x = zero_crossing_variance(m, noise);
    }
    // Gone astray: further from where it began than the two methods can differ on one line.
    auto good = hn::Gt(hn::Load(d, s.good + lane), hn::Zero(d));
    good = hn::And(good, hn::Le(hn::Abs(hn::Sub(m.x, hn::Load(d, s.x_start + lane))), hn::Max(set(3.f), m.width)));
    // Not a line: light that noise could have made, were position and width known (speckle makes no light).
    const auto light_information = hn::Div(hn::Mul(hn::Mul(m.amplitude, m.amplitude), hn::Mul(m.width, set(1.7725f))),
                                           hn::MulAdd(noise.shot, m.amplitude, noise.ambient));
    good = hn::And(good, hn::And(hn::Gt(light_information, set(25.f)), hn::Gt(variance_x, hn::Zero(d))));
    hn::Store(hn::Sqrt(hn::Max(variance_x, hn::Zero(d))), d, s.sigma_x + lane);
    hn::Store(hn::IfThenElseZero(good, set(1.f)), d, s.good + lane);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace celadon::line_kernels
HWY_AFTER_NAMESPACE();
#endif
