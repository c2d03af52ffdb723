// What successive profiles have in common, against what was put into them.

#include "daemon/checks/profile_jitter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>
#include <random>

namespace celadon {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;

using Body = std::function<double(double theta_rad, double z_mm)>;
double round_body(double, double z) {
  return 30 + 2 * std::sin(z / 20);
}
double freeform(double t, double z) {
  return 33 + 2.4 * std::cos(3 * t + 0.01 * z) + 0.5 * std::sin(2 * t + 0.02 * z);
}
/// Five lobes with steep flanks.
double lobes(double t, double) {
  return 26 + 7 * std::tanh(2 * std::sin(5 * t)) / std::tanh(2.);
}

struct Scan {
  int profiles = 600, rows = 300;
  double noise_mm = 0.02;
  double row_correlation = 0;                                     ///< of a row's noise with that of the row below
  std::function<double(int)> common_mm = [](int) { return 0.; };  ///< of a profile
  std::function<bool(int)> lost = [](int) { return false; };      ///< profile by profile
  std::function<double(int)> step = [](int) { return 1.; };       ///< of the angle, in regular ones
  unsigned seed = 1;
};

std::optional<JitterResult> jitter_of(const Body& body, const Scan& scan) {
  std::mt19937 random(scan.seed);
  std::normal_distribution<double> normal;
  ProfileJitter jitter;
  double angle_rad = 1;
  for (int k = 0; k < scan.profiles; ++k) {
    angle_rad += scan.step(k) * kTurn_rad / scan.profiles;
    if (scan.lost(k)) continue;
    Profile p;
    p.table_angle_rad = angle_rad;
    double noise = normal(random);
    for (int row = 0; row < scan.rows; ++row) {
      const double z = 0.3 * row, rho = scan.row_correlation;
      noise = rho * noise + std::sqrt(1 - rho * rho) * normal(random);
      p.row.push_back(static_cast<std::uint16_t>(row));
      p.z_mm.push_back(z);
      p.theta_rad.push_back(-angle_rad);
      p.r_mm.push_back(body(angle_rad, z) + scan.common_mm(k) + scan.noise_mm * noise);
    }
    jitter.add(p);
  }
  return jitter.result();
}

// The mean of 300 samples has the standard deviation sigma sqrt(kappa / 300), kappa = (1 + rho) / (1 - rho).
TEST(ProfileJitter, IsTheSamplesOwnNoiseWhereNothingShakes) {
  for (const Body& body : {Body(round_body), Body(freeform)}) {
    for (const double rho : {0., 0.5}) {
      const auto found = jitter_of(body, {.row_correlation = rho});
      ASSERT_TRUE(found);
      const double expected = 0.02 * std::sqrt((1 + rho) / (1 - rho) / 300);
      EXPECT_NEAR(found->noise_mm, expected, 0.1 * expected);
      EXPECT_NEAR(found->mm, found->noise_mm, 4 * found->u_mm);
      EXPECT_GT(found->profiles, 590u);
    }
  }
}

TEST(ProfileJitter, IsWhatProfilesHaveInCommon) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal(0, 0.02);
  std::vector<double> shaken(600);
  for (double& s : shaken) s = normal(random);
  for (const Body& body : {Body(round_body), Body(freeform), Body(lobes)}) {
    const auto found = jitter_of(body, {.common_mm = [&](int k) { return shaken[static_cast<std::size_t>(k)]; }});
    ASSERT_TRUE(found);
    EXPECT_NEAR(found->mm, 0.02, 0.003);
  }
}

// Flanks are as steep as 70 mm a radian, and the corners beside them bend within a few degrees.
TEST(ProfileJitter, ASteepShapeIsNone) {
  const auto found = jitter_of(lobes, {.profiles = 360});
  ASSERT_TRUE(found);
  EXPECT_LT(found->mm, 0.004);
}

TEST(ProfileJitter, UnequalStepsAndLostFramesAreNone) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> step(0.85, 1.15);
  const auto found =
      jitter_of(freeform, {.lost = [](int k) { return k % 50 == 7; }, .step = [&](int) { return step(random); }});
  ASSERT_TRUE(found);
  EXPECT_NEAR(found->mm, found->noise_mm, 4 * found->u_mm);
  EXPECT_GT(found->profiles, 500u);
}

// Two turns, the second seen from elsewhere: what lies on both sides of the change is not compared.
TEST(ProfileJitter, AnotherTurnBeginsAnew) {
  ProfileJitter jitter;
  for (int turn = 0; turn < 2; ++turn) {
    for (int k = 0; k < 31; ++k) {
      Profile p;
      p.laser = static_cast<std::uint8_t>(turn);
      p.table_angle_rad = 0.01 * k;
      for (int row = 0; row < 100; ++row) {
        p.row.push_back(static_cast<std::uint16_t>(row));
        p.r_mm.push_back(30 + 10 * turn);
      }
      jitter.add(p);
    }
  }
  EXPECT_FALSE(jitter.result());  // 2 (31 - 4) = 54 compared
}

TEST(ProfileJitter, FewRowsOrProfilesTellNothing) {
  EXPECT_FALSE(jitter_of(round_body, {.profiles = 60}));
  EXPECT_FALSE(jitter_of(round_body, {.rows = 40}));
}

}  // namespace
}  // namespace celadon
