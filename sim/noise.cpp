#include "sim/noise.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sim/noise.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include <algorithm>
#include <cmath>

HWY_BEFORE_NAMESPACE();
namespace celadon::sim::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using DU = hn::ScalableTag<std::uint32_t>;
using DF = hn::ScalableTag<float>;
using VU = hn::VFromD<DU>;
using VF = hn::VFromD<DF>;

// The two halves of random_words().
HWY_INLINE VU First(const RandomKey& key, VU x) {
  const DU du;
  x = hn::Xor(x, hn::Set(du, key.a));
  x = hn::Mul(hn::Xor(x, hn::ShiftRight<16>(x)), hn::Set(du, 0x7feb352dU));
  x = hn::Xor(x, hn::Set(du, key.b));
  x = hn::Mul(hn::Xor(x, hn::ShiftRight<15>(x)), hn::Set(du, 0x846ca68bU));
  return hn::Xor(x, hn::ShiftRight<16>(x));
}
HWY_INLINE VU Second(const RandomKey& key, VU x) {
  const DU du;
  x = hn::Add(x, hn::Set(du, key.c));
  x = hn::Mul(hn::Xor(x, hn::ShiftRight<16>(x)), hn::Set(du, 0x21f0aaadU));
  x = hn::Mul(hn::Xor(x, hn::ShiftRight<15>(x)), hn::Set(du, 0x735a2d97U));
  return hn::Xor(x, hn::ShiftRight<15>(x));
}

// No fused operations: every SIMD level then rounds alike.
HWY_INLINE VF Gaussian(const RandomKey& key, VU counter) {
  const DU du;
  const DF df;
  const hn::RebindToSigned<DU> di;
  const VU first = First(key, counter);
  const VU second = Second(key, first);
  const VU mask = hn::Set(du, 0x00ff00ffU);
  const VU pairs = hn::Add(hn::Add(hn::And(first, mask), hn::And(hn::ShiftRight<8>(first), mask)),
                           hn::Add(hn::And(second, mask), hn::And(hn::ShiftRight<8>(second), mask)));
  const VU sum = hn::Add(hn::And(pairs, hn::Set(du, 0xffffU)), hn::ShiftRight<16>(pairs));
  const VF s = hn::Mul(hn::Sub(hn::ConvertTo(df, hn::BitCast(di, sum)), hn::Set(df, kGaussianMean)),
                       hn::Set(df, kGaussianInverseSd));
  const VF correction =
      hn::Add(hn::Mul(hn::Sub(hn::Mul(s, s), hn::Set(df, 3.F)), hn::Set(df, kGaussianCubic)), hn::Set(df, 1.F));
  return hn::Mul(hn::Mul(s, correction), hn::Set(df, kGaussianScale));
}

// Whole vectors from the row itself, the rest of it through a buffer of one vector.
void ExposeRow(const float* HWY_RESTRICT levels, float factor, std::size_t count, const SensorNoise& noise,
               const RandomKey& key, std::uint32_t first, std::uint8_t* HWY_RESTRICT out) {
  const DU du;
  const DF df;
  const hn::RebindToSigned<DU> di;
  const hn::Rebind<std::uint8_t, DF> d8;
  const std::size_t lanes = hn::Lanes(df);
  const VF inverse_electrons = hn::Set(df, 1.F / noise.electrons_per_level);
  const VF read_variance = hn::Set(df, noise.read_levels * noise.read_levels);
  const VF offset = hn::Set(df, noise.pedestal + 0.5F);
  const VU steps = hn::Iota(du, 0);
  const VF scale = hn::Set(df, factor);
  const auto exposed = [&](VF level, std::uint32_t counter) {
    const VF m = hn::Mul(level, scale);
    const VF sd = hn::Sqrt(hn::Add(hn::Mul(m, inverse_electrons), read_variance));
    const VF v = hn::Add(hn::Add(m, offset), hn::Mul(sd, Gaussian(key, hn::Add(steps, hn::Set(du, counter)))));
    const VF clamped = hn::Min(hn::Max(v, hn::Zero(df)), hn::Set(df, 255.F));
    return hn::DemoteTo(d8, hn::ConvertTo(di, clamped));
  };
  std::size_t i = 0;
  for (; i + lanes <= count; i += lanes) {
    hn::StoreU(exposed(hn::LoadU(df, levels + i), first + static_cast<std::uint32_t>(i)), d8, out + i);
  }
  if (i < count) {
    HWY_ALIGN float last[HWY_MAX_BYTES / sizeof(float)] = {};
    HWY_ALIGN std::uint8_t bytes[HWY_MAX_BYTES] = {};
    std::copy(levels + i, levels + count, last);
    hn::StoreU(exposed(hn::Load(df, last), first + static_cast<std::uint32_t>(i)), d8, bytes);
    std::copy(bytes, bytes + (count - i), out + i);
  }
}

void GaussianRow(const RandomKey& key, std::uint32_t first, std::size_t count, float* HWY_RESTRICT out) {
  const DU du;
  const DF df;
  const std::size_t lanes = hn::Lanes(df);
  const VU steps = hn::Iota(du, 0);
  std::size_t i = 0;
  for (; i + lanes <= count; i += lanes) {
    hn::StoreU(Gaussian(key, hn::Add(steps, hn::Set(du, first + static_cast<std::uint32_t>(i)))), df, out + i);
  }
  for (; i < count; ++i) out[i] = random_gaussian(key, first + static_cast<std::uint32_t>(i));
}

const char* TargetName() {
  return hwy::TargetName(HWY_TARGET);
}

}  // namespace celadon::sim::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace celadon::sim {
HWY_EXPORT(ExposeRow);
HWY_EXPORT(GaussianRow);
HWY_EXPORT(TargetName);

void expose_row(const float* levels, float factor, std::size_t count, const SensorNoise& noise, const RandomKey& key,
                std::uint32_t first, std::uint8_t* out) {
  HWY_DYNAMIC_DISPATCH(ExposeRow)(levels, factor, count, noise, key, first, out);
}

void gaussian_row(const RandomKey& key, std::uint32_t first, std::size_t count, float* out) {
  HWY_DYNAMIC_DISPATCH(GaussianRow)(key, first, count, out);
}

const char* noise_simd_target() {
  return HWY_DYNAMIC_DISPATCH(TargetName)();
}

}  // namespace celadon::sim
#endif
