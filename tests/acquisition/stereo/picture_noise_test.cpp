// Photon transfer of drawn pictures.

#include "acquisition/stereo/picture_noise.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

namespace celadon {
namespace {

constexpr int kWide = 200, kHigh = 150;

CameraMode mode() {
  CameraMode mode;
  mode.width_px = kWide;
  mode.height_px = kHigh;
  mode.stride_bytes = kWide;
  return mode;
}

std::vector<std::vector<std::uint8_t>> pictures(double read, double per_level, double low, double high) {
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  std::vector<std::vector<std::uint8_t>> out(8);
  for (auto& picture : out) {
    for (int i = 0; i < kWide * kHigh; ++i) {
      const double level = low + (high - low) * (i % kWide) / kWide;
      const double seen = level + std::sqrt(read * read + per_level * level) * normal(random);
      picture.push_back(static_cast<std::uint8_t>(std::clamp(std::lround(seen), 0L, 255L)));
    }
  }
  return out;
}

TEST(PictureNoise, IsReadAndShotNoise) {
  const PictureNoise noise = noise_of(mode(), pictures(1.5, 0.025, 10, 200));
  for (const double level : {20., 100., 180.})
    EXPECT_NEAR(noise.variance(level), 2.25 + 0.025 * level + 1. / 12, 0.04 * (2.25 + 0.025 * level)) << level;
}

TEST(PictureNoise, IsOneNumberWhereAllIsOneLevel) {
  const PictureNoise noise = noise_of(mode(), pictures(2, 0, 99, 101));
  EXPECT_NEAR(noise.variance(100), 4.08, 0.3);
}

TEST(PictureNoise, IsNeverBelowRoundingAndKnowsNothingOfSaturatedPixels) {
  const std::vector<std::vector<std::uint8_t>> same(3, std::vector<std::uint8_t>(kWide * kHigh, 80)),
      white(3, std::vector<std::uint8_t>(kWide * kHigh, 255));
  EXPECT_NEAR(noise_of(mode(), same).variance(80), 1. / 12, 1e-9);
  EXPECT_NEAR(noise_of(mode(), white).variance(200), 1. / 12, 1e-9);
}

}  // namespace
}  // namespace celadon
