// Two lasers on the same object, in closed form: what they disagree by comes back, and its cause is named.

#include "daemon/laser_agreement.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

namespace celadon {
namespace {

constexpr double kNoise_mm = 0.02;
constexpr int kProfiles = 240, kRows = 400;

/// What laser 1 says too much at a place; laser 0 says the truth.
using Error = double (*)(double theta_rad, double height);

/// A turn with each laser over a body r(theta, z), which laser 1 samples at other angles and heights than laser 0.
template <class Radius>
LaserAgreement seen_by_two(const Radius& radius, Error error, unsigned seed = 1) {
  GridSpecification band;
  band.z_start_mm = 10;
  band.z_end_mm = 90;
  const int lasers[] = {0, 1};
  LaserAgreement agreement(band, lasers, kProfiles);
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0, kNoise_mm);
  for (const int laser : lasers) {
    for (int k = 0; k < kProfiles; ++k) {
      Profile p;
      p.laser = static_cast<std::uint8_t>(laser);
      for (int row = 0; row < kRows; ++row) {
        const double theta = 2 * std::numbers::pi * (k + 0.4 * laser) / kProfiles - 1.7;
        const double z = 5 + 90 * (row + 0.3 * laser) / kRows;
        p.theta_rad.push_back(theta);
        p.z_mm.push_back(z);
        p.r_mm.push_back(radius(theta, z) + noise(random) + (laser == 1 ? error(theta, (z - 50) / 40) : 0));
      }
      agreement.add(p);
    }
  }
  return agreement;
}

double cylinder(double, double) {
  return 30;
}
/// Steep in both directions: a cell's samples differ by a hundred times the noise.
double cone(double theta, double z) {
  return 20 + 0.9 * z + 6 * std::cos(2 * theta);
}
double none(double, double) {
  return 0;
}

TEST(LaserAgreement, NoiseAloneIsNoDisagreement) {
  for (unsigned seed = 1; seed <= 40; ++seed) {
    const auto error = seen_by_two(seed % 2 == 0 ? cylinder : cone, none, seed).result();
    ASSERT_TRUE(error);
    EXPECT_LT(std::abs(error->bias), 3 * error->bias_sd) << seed;
    EXPECT_NEAR(error->rms, error->noise, 0.1 * error->noise) << seed;
  }
}

TEST(LaserAgreement, TheStandardErrorIsThatOfTheMean) {
  // 240 x 400 samples of each, of which 80 mm of 90 lie in the band.
  const double samples = 240 * 400 * 80. / 90;
  const auto error = seen_by_two(cylinder, none).result();
  ASSERT_TRUE(error);
  EXPECT_NEAR(error->bias_sd, kNoise_mm * std::sqrt(2 / samples), 0.3 * kNoise_mm * std::sqrt(2 / samples));
}

TEST(LaserAgreement, AnOffsetIsAPlaneThatMoved) {
  const auto error = seen_by_two(cone, [](double, double) { return 0.01; }).result();
  ASSERT_TRUE(error);
  EXPECT_EQ(error->first, 0);
  EXPECT_EQ(error->second, 1);
  EXPECT_NEAR(error->bias, 0.01, 5 * error->bias_sd);
  EXPECT_EQ(cause_of(*error).cause, "the plane of laser 0 or 1 is no longer where it was calibrated");
}

TEST(LaserAgreement, ATiltIsAPlaneThatMovedToo) {
  const auto error = seen_by_two(cylinder, [](double, double height) { return 0.05 * height; }).result();
  ASSERT_TRUE(error);
  EXPECT_NEAR(error->tilt, 0.05, 0.002);
  EXPECT_NEAR(error->bias, 0, 0.001);
  EXPECT_EQ(cause_of(*error).cause, "the plane of laser 0 or 1 is no longer where it was calibrated");
}

TEST(LaserAgreement, AShiftIsAnObjectThatMoved) {
  const auto error = seen_by_two(cylinder, [](double theta, double) { return 0.08 * std::cos(theta - 0.7); }).result();
  ASSERT_TRUE(error);
  EXPECT_NEAR(error->shift, 0.08, 0.002);
  EXPECT_NEAR(error->bias, 0, 0.001);
  EXPECT_NEAR(error->rms, 0.08 / std::sqrt(2), 0.003);
  EXPECT_EQ(cause_of(*error).cause, "the object moved between the two turns, by about 0.080 mm");
}

TEST(LaserAgreement, AnythingElseIsTheSurface) {
  const auto error = seen_by_two(cylinder, [](double theta, double) { return 0.08 * std::cos(5 * theta); }).result();
  ASSERT_TRUE(error);
  EXPECT_NE(cause_of(*error).cause.find("gloss"), std::string::npos) << cause_of(*error).cause;
}

// Gloss and light from below the surface are tenths of a millimetre.
TEST(LaserAgreement, WhatNoSurfaceDoesIsSwappedLasers) {
  const auto error = seen_by_two(cylinder, [](double theta, double) { return 1.5 * std::cos(5 * theta); }).result();
  ASSERT_TRUE(error);
  EXPECT_NE(cause_of(*error).cause.find("swapped"), std::string::npos) << cause_of(*error).cause;
}

// A step of 5 mm inside some cells says nothing of the lasers.
TEST(LaserAgreement, StepsAreLeftOut) {
  const auto error = seen_by_two([](double, double z) { return z < 43.3 ? 30. : 25.; }, none).result();
  ASSERT_TRUE(error);
  EXPECT_LT(error->rms, 1.2 * error->noise);
  EXPECT_LT(std::abs(error->bias), 3 * error->bias_sd);
}

TEST(LaserAgreement, OneLaserOrNothingInCommonIsNoResult) {
  GridSpecification band;
  band.z_start_mm = 0;
  band.z_end_mm = 10;
  const int one[] = {0}, two[] = {0, 1};
  Profile p;
  for (int row = 0; row < 1000; ++row) {
    p.theta_rad.push_back(0.001 * row);
    p.z_mm.push_back(0.01 * row);
    p.r_mm.push_back(30);
  }
  LaserAgreement alone(band, one, 100), apart(band, two, 100);
  alone.add(p);
  EXPECT_FALSE(alone.result());
  apart.add(p);
  p.laser = 7;  // not of this scan
  apart.add(p);
  EXPECT_FALSE(apart.result());
}

}  // namespace
}  // namespace celadon
