#pragma once
// Counter-based random numbers: a value is a pure function of (key, counter), so a pixel's noise depends on seed, frame
// and place alone, never on the order of drawing.

#include <cmath>
#include <cstdint>

namespace celadon::sim {

/// 96 bits that name one stream of random numbers.
struct RandomKey {
  std::uint32_t a = 0, b = 0, c = 0;
};

/// splitmix64's finaliser; for keys.
inline std::uint64_t mix64(std::uint64_t x) {
  x += 0x9e3779b97f4a7c15ULL;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

/// The key of (seed, purpose, index), e.g. (seed, "pixel noise", frame number).
inline RandomKey make_key(std::uint64_t seed, std::uint64_t purpose, std::uint64_t index) {
  const std::uint64_t h = mix64(mix64(mix64(seed) ^ purpose) ^ index), g = mix64(h);
  return {static_cast<std::uint32_t>(h), static_cast<std::uint32_t>(h >> 32), static_cast<std::uint32_t>(g)};
}

/// 64 random bits of one counter as two words, each a 32-bit mixer of two multiplications and three shifts with full
/// avalanche. The key enters between the steps, so two keys never give shifted copies of one sequence.
struct RandomWords {
  std::uint32_t first, second;
};
inline RandomWords random_words(const RandomKey& key, std::uint32_t counter) {
  std::uint32_t x = counter ^ key.a;
  x = (x ^ (x >> 16)) * 0x7feb352dU;
  x ^= key.b;
  x = (x ^ (x >> 15)) * 0x846ca68bU;
  x ^= x >> 16;
  std::uint32_t y = x + key.c;
  y = (y ^ (y >> 16)) * 0x21f0aaadU;
  y = (y ^ (y >> 15)) * 0x735a2d97U;
  return {x, y ^ (y >> 15)};
}

/// Uniform in [0, 1).
inline double random_uniform(const RandomKey& key, std::uint32_t counter) {
  return random_words(key, counter).second * 0x1p-32;
}

// A standard normal deviate from the sum S of eight random bytes: s = (S - 1020) / 209.02, then s + c (s^3 - 3 s), a
// Cornish-Fisher step with c chosen so that the kurtosis is 3.000; kGaussianScale restores unit variance. Sixth moment
// 14.88 (15), range +-5.6, tail probabilities within 10 % of the normal law out to 3.5 standard deviations.
inline constexpr float kGaussianMean = 1020.F;
inline constexpr float kGaussianInverseSd = 0.00478419615F;
inline constexpr float kGaussianCubic = 0.0075F;
inline constexpr float kGaussianScale = 1.00099272F;

/// Standard normal deviate of one counter; the vector kernels in noise.cpp give the same bits.
inline float random_gaussian(const RandomKey& key, std::uint32_t counter) {
  const RandomWords w = random_words(key, counter);
  constexpr std::uint32_t kMask = 0x00ff00ffU;
  const std::uint32_t pairs =
      (w.first & kMask) + ((w.first >> 8) & kMask) + (w.second & kMask) + ((w.second >> 8) & kMask);
  const std::uint32_t sum = (pairs & 0xffffU) + (pairs >> 16);
  const float s = (static_cast<float>(static_cast<std::int32_t>(sum)) - kGaussianMean) * kGaussianInverseSd;
  const float correction = (s * s - 3.F) * kGaussianCubic + 1.F;
  return s * correction * kGaussianScale;
}

}  // namespace celadon::sim
