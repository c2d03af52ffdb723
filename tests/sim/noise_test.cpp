#include "sim/noise.h"

#include <gtest/gtest.h>

#include <hwy/targets.h>
#include <cmath>
#include <vector>

namespace celadon::sim {
namespace {

struct Moments {
  double mean = 0, variance = 0, skew = 0, kurtosis = 0;
};
template <class T>
Moments moments(const std::vector<T>& v) {
  Moments m;
  const double n = static_cast<double>(v.size());
  for (const T x : v) m.mean += static_cast<double>(x) / n;
  double m3 = 0, m4 = 0;
  for (const T x : v) {
    const double d = static_cast<double>(x) - m.mean;
    m.variance += d * d / n;
    m3 += d * d * d / n;
    m4 += d * d * d * d / n;
  }
  m.skew = m3 / std::pow(m.variance, 1.5);
  m.kurtosis = m4 / (m.variance * m.variance);
  return m;
}

TEST(Noise, GaussianHasTheMomentsOfANormal) {
  std::vector<float> g(2'000'000);
  gaussian_row(make_key(1, 2, 3), 0, g.size(), g.data());
  const Moments m = moments(g);
  // Four standard errors each.
  EXPECT_NEAR(m.mean, 0, 4 / std::sqrt(2e6));
  EXPECT_NEAR(m.variance, 1, 4 * std::sqrt(2 / 2e6));
  EXPECT_NEAR(m.skew, 0, 4 * std::sqrt(6 / 2e6));
  EXPECT_NEAR(m.kurtosis, 3, 4 * std::sqrt(24 / 2e6));
  double beyond = 0;
  for (const float x : g) beyond += std::abs(x) > 3 ? 1 : 0;
  EXPECT_NEAR(beyond / 2e6, 0.0027, 0.0003);
}

double correlation(const std::vector<float>& a, const std::vector<float>& b, std::size_t shift) {
  double sum = 0;
  for (std::size_t i = 0; i + shift < a.size(); ++i)
    sum += static_cast<double>(a[i]) * static_cast<double>(b[i + shift]);
  return sum / static_cast<double>(a.size() - shift);
}

// Between pixels of a frame (also of squares, which a shared table would show) and between frames.
TEST(Noise, PixelsAndFramesAreIndependent) {
  constexpr std::size_t n = 1'000'000;
  std::vector<float> a(n), b(n);
  gaussian_row(make_key(7, 1, 100), 0, n, a.data());
  gaussian_row(make_key(7, 1, 101), 0, n, b.data());
  const double bound = 4.5 / std::sqrt(static_cast<double>(n));
  for (const std::size_t shift : {1U, 2U, 3U, 8U, 16U, 1280U, 65536U})
    EXPECT_LT(std::abs(correlation(a, a, shift)), bound) << shift;
  for (const std::size_t shift : {0U, 1U, 2U, 1280U}) EXPECT_LT(std::abs(correlation(a, b, shift)), bound) << shift;
  std::vector<float> squares(n), squares_b(n);
  for (std::size_t i = 0; i < n; ++i) {
    squares[i] = a[i] * a[i] - 1;
    squares_b[i] = b[i] * b[i] - 1;
  }
  for (const std::size_t shift : {1U, 2U, 16U, 1280U})
    EXPECT_LT(std::abs(correlation(squares, squares, shift)), 2 * bound) << shift;
  EXPECT_LT(std::abs(correlation(squares, squares_b, 0)), 2 * bound);
}

TEST(Noise, VarianceFollowsShotAndReadNoise) {
  constexpr std::size_t n = 400'000;
  SensorNoise noise;
  noise.pedestal = 20;
  for (const float level : {0.F, 10.F, 60.F, 150.F}) {
    const std::vector<float> mean(n, level);
    std::vector<std::uint8_t> out(n);
    expose_row(mean.data(), 1, n, noise, make_key(3, 1, 9), 0, out.data());
    const Moments m = moments(out);
    // Rounding to whole levels adds 1/12.
    const double variance = static_cast<double>(level) / 40 + 1.5 * 1.5 + 1.0 / 12;
    EXPECT_NEAR(m.mean, 20 + static_cast<double>(level), 4 * std::sqrt(variance / n));
    EXPECT_NEAR(m.variance, variance, 5 * variance * std::sqrt(2.0 / n));
  }
}

TEST(Noise, SaturatesAtBlackAndWhite) {
  SensorNoise noise;
  noise.pedestal = 0;
  const std::vector<float> mean{0, 0, 0, 1e6F, 400, 255.4F};
  std::vector<std::uint8_t> out(mean.size());
  expose_row(mean.data(), 1, mean.size(), noise, make_key(1, 1, 1), 0, out.data());
  EXPECT_EQ(out[3], 255);
  EXPECT_EQ(out[4], 255);
  noise.read_levels = 100;
  std::vector<float> dark(1000, 0.F);
  std::vector<std::uint8_t> bytes(1000);
  expose_row(dark.data(), 1, dark.size(), noise, make_key(1, 1, 1), 0, bytes.data());
  EXPECT_GT(std::count(bytes.begin(), bytes.end(), 0), 300);
}

// The scalar formula of random.h, whole rows and pieces of them, on every SIMD level this processor has.
TEST(Noise, SameBitsOnEverySimdLevelAndForAnyCut) {
  const RandomKey key = make_key(42, 1, 17);
  constexpr std::size_t n = 1003;
  std::vector<float> mean(n);
  for (std::size_t i = 0; i < n; ++i) mean[i] = static_cast<float>(i % 200);
  std::vector<std::uint8_t> reference;
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    std::vector<float> g(n);
    gaussian_row(key, 5, n, g.data());
    for (std::size_t i = 0; i < n; ++i)
      ASSERT_EQ(g[i], random_gaussian(key, static_cast<std::uint32_t>(5 + i))) << hwy::TargetName(target);
    std::vector<std::uint8_t> whole(n), pieces(n);
    expose_row(mean.data(), 1, n, {}, key, 0, whole.data());
    for (std::size_t at = 0; at < n;) {
      const std::size_t piece = std::min<std::size_t>(n - at, 1 + at % 37);
      expose_row(mean.data() + at, 1, piece, {}, key, static_cast<std::uint32_t>(at), pieces.data() + at);
      at += piece;
    }
    EXPECT_EQ(whole, pieces);
    if (reference.empty()) reference = whole;
    EXPECT_EQ(whole, reference) << hwy::TargetName(target);
  }
  hwy::SetSupportedTargetsForTest(0);
}

}  // namespace
}  // namespace celadon::sim
