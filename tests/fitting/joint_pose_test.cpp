// Poses refined with the surface, against those that the samples were made with.
#include "fitting/joint_pose.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <random>
#include <string>

#include "fitting/moved_stream.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::kPi;

double vase(double t, double z) {
  return 30 + 6 * std::sin(2 * kPi * z / 120) + 2 * std::cos(3 * t) * std::sin(kPi * z / 120) + 0.8 * std::cos(5 * t);
}

// Samples of the body between two heights as a scanner sees it that stands at X (body to scanner).
test::MemoryStream seen(double low, double high, double sigma, const Eigen::Isometry3d& X, unsigned seed,
                        const test::Shape& shape = vase) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  test::MemoryStream stream;
  for (int i = 0; i < 150; ++i) {
    Profile p;
    p.order = ProfileOrder::scattered;
    for (int j = 0; j < 100; ++j) {
      const double t = 2 * kPi * (i + 0.5) / 150, z = low + (high - low) * (j + 0.5) / 100;
      const double r = shape(t, z) + sigma * normal(random);
      const Eigen::Vector3d q = X * Eigen::Vector3d(r * std::cos(t), r * std::sin(t), z);
      const double turned = std::atan2(q.y(), q.x());
      test::push(p, std::hypot(q.x(), q.y()), turned < 0 ? turned + 2 * kPi : turned, q.z());
    }
    stream.profiles.push_back(std::move(p));
  }
  return stream;
}

Eigen::Isometry3d pose(double x, double y, double z, double tilt, double turn) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.translation() << x, y, z;
  X.linear() =
      (Eigen::AngleAxisd(tilt, Eigen::Vector3d(0.6, 0.8, 0)) * Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()))
          .toRotationMatrix();
  return X;
}

RangeFunction first_fit(test::MemoryStream& a, test::MemoryStream& b) {
  std::vector<ProfileStream*> parts{&a, &b};
  JoinedStream both(parts);
  RangeFitOptions options;
  options.robust = false;
  const auto fit = fit_samples(both, options);
  EXPECT_TRUE(fit) << fit.error().message;
  return fit->function;
}

// Two heights of a lift: the error of the shift is what its standard deviation says, over many draws.
TEST(JointPose, TheHeightOfALiftComesWithItsStandardDeviation) {
  constexpr int kTrials = 24;
  double chi_square = 0;
  for (unsigned k = 0; k < kTrials; ++k) {
    const double off = 0.3 - 0.02 * k;
    test::MemoryStream low = seen(0, 75, 0.05, pose(0, 0, 0, 0, 0), 2 * k + 1),
                       high = seen(50, 120, 0.05, pose(0, 0, off, 0, 0), 2 * k + 2);
    const auto joint = refine_pose(first_fit(low, high), low, high, PoseFreedom::along_axis, 0.05);
    ASSERT_TRUE(joint) << joint.error().message;
    const double error = joint->X_12.translation().z() + off;
    EXPECT_EQ(joint->X_12.translation().head<2>().norm(), 0);
    EXPECT_LT(std::abs(error), 4.5 * joint->shift_sd_mm);
    chi_square += std::pow(error / joint->shift_sd_mm, 2);
  }
  // 99.9 % of chi-square with 24 degrees of freedom, both sides.
  EXPECT_GT(chi_square, 7.8);
  EXPECT_LT(chi_square, 51.2);
}

TEST(JointPose, AllSixWithoutNoise) {
  const Eigen::Isometry3d off = pose(0.2, -0.15, 0.25, 0.004, 0.006);
  test::MemoryStream low = seen(0, 80, 0, Eigen::Isometry3d::Identity(), 1), high = seen(40, 120, 0, off, 2);
  const auto joint = refine_pose(first_fit(low, high), low, high, PoseFreedom::all, 1e-3);
  ASSERT_TRUE(joint) << joint.error().message;
  const Eigen::Isometry3d left = joint->X_12 * off;
  // What a spline of this many knots does not follow of the body is what is left.
  EXPECT_LT(left.translation().norm(), 2e-4);
  EXPECT_LT(Eigen::AngleAxisd(left.linear()).angle(), 1e-5);
}

TEST(JointPose, TurnAndShiftUnderNoiseAndStrays) {
  const Eigen::Isometry3d off = pose(0, 0, -0.2, 0, 0.01);
  test::MemoryStream low = seen(0, 80, 0.03, Eigen::Isometry3d::Identity(), 1), high = seen(45, 120, 0.03, off, 2);
  std::mt19937_64 random(3);
  for (Profile& p : high.profiles)
    for (std::size_t k = 0; k < p.size(); ++k)
      if (random() % 10 == 0) p.r_mm[k] += 3;
  const RangeFunction start = first_fit(low, low);
  const auto joint = refine_pose(first_fit(low, high), low, high, PoseFreedom::along_about, 0.03);
  ASSERT_TRUE(joint) << joint.error().message;
  const Eigen::Isometry3d left = joint->X_12 * off;
  EXPECT_LT(std::abs(left.translation().z()), 5 * joint->shift_sd_mm);
  EXPECT_LT(Eigen::AngleAxisd(left.linear()).angle(), 5 * joint->turn_sd_rad);
  EXPECT_LT(joint->shift_sd_mm, 0.01);
}

TEST(JointPose, WhatSlidesIsRefused) {
  const test::Shape rod = [](double, double) { return 20.0; };
  test::MemoryStream low = seen(0, 75, 0.05, pose(0, 0, 0, 0, 0), 1, rod),
                     high = seen(50, 120, 0.05, pose(0, 0, 0.2, 0, 0), 2, rod);
  const auto joint = refine_pose(first_fit(low, high), low, high, PoseFreedom::along_axis, 0.05);
  ASSERT_FALSE(joint) << joint->shift_sd_mm;
  EXPECT_NE(joint.error().message.find("slides along itself"), std::string::npos) << joint.error().message;
}

}  // namespace
}  // namespace celadon
