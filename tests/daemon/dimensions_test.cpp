#include "daemon/dimensions.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>
#include <random>

#include "tests/acquisition/test_calibration.h"

namespace celadon {
namespace {

using Eigen::Vector3d;

/// Without uncertainty: what is stated is the points' scatter.
Calibration sure_calibration() {
  Calibration c = test_calibration();
  c.scale = {1, 0};
  c.systematic_mm = 0;
  return c;
}

/// Profiles all around of a shape given as radius by height, moved and leaning.
ScannedPoints turn_of(const std::function<double(double z)>& radius, int profiles,
                      const std::function<double()>& shared, const std::function<double()>& own) {
  ScannedPoints out;
  std::vector<Vector3d> points;
  const Eigen::Isometry3d X = Eigen::Translation3d(3, -2, 1) * Eigen::AngleAxisd(0.02, Vector3d(0.6, -0.8, 0));
  for (int k = 0; k < profiles; ++k) {
    const double angle = 2 * std::numbers::pi * k / profiles, off = shared();
    for (double z = 20; z <= 80; z += 3) {
      const double r = radius(z) + off + own();
      points.push_back(X * Vector3d(r * std::cos(angle), r * std::sin(angle), z));
      out.table_angle_rad.push_back(angle);
      out.laser.push_back(0);
    }
  }
  out.p_mm.resize(3, static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i) out.p_mm.col(static_cast<Eigen::Index>(i)) = points[i];
  return out;
}

double none() {
  return 0;
}

TEST(Dimensions, ExactShapesAreExact) {
  const auto cylinder =
      dimensions_of(RoundShape::cylinder, turn_of([](double) { return 40.0; }, 24, none, none), sure_calibration());
  ASSERT_TRUE(cylinder) << cylinder.error();
  EXPECT_NEAR(cylinder->values[0].value, 80, 1e-8);
  const auto sphere = dimensions_of(
      RoundShape::sphere, turn_of([](double z) { return std::sqrt(35 * 35 - (z - 50) * (z - 50)); }, 24, none, none),
      sure_calibration());
  ASSERT_TRUE(sphere) << sphere.error();
  EXPECT_NEAR(sphere->values[0].value, 70, 1e-8);
  const auto cone = dimensions_of(RoundShape::cone, turn_of([](double z) { return 20 + 0.1 * z; }, 24, none, none),
                                  sure_calibration(), 51);
  ASSERT_TRUE(cone) << cone.error();
  // The axis's point at height 51 of the scanner frame is at (51 - 1) / cos 0.02 of the object's.
  EXPECT_NEAR(cone->values[0].value, 2 * (20 + 0.1 * 50 / std::cos(0.02)), 1e-7);
  EXPECT_NEAR(cone->values[1].value, 2 * std::atan(0.1), 1e-9);
  EXPECT_EQ(cone->values[0].name, "diameter at z = 51 mm");
}

// Errors that a profile's points share count once a profile: over 300 scans, stated against observed.
TEST(Dimensions, ScatterIsStatedAsItIs) {
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  double squares = 0, stated = 0;
  constexpr int kScans = 300;
  for (int scan = 0; scan < kScans; ++scan) {
    const auto found = dimensions_of(RoundShape::cylinder,
                                     turn_of([](double) { return 40.0; }, 36, [&] { return 0.03 * normal(random); },
                                             [&] { return 0.02 * normal(random); }),
                                     sure_calibration());
    ASSERT_TRUE(found) << found.error();
    squares += std::pow(found->values[0].value - 80, 2) / kScans;
    stated += std::pow(found->values[0].u, 2) / kScans;
    EXPECT_EQ(found->values[0].u_calibration, 0);
  }
  EXPECT_GT(std::sqrt(squares), 0.008);  // 2 x 0.03 / sqrt(36)
  EXPECT_NEAR(std::sqrt(stated / squares), 1, 0.12);
}

TEST(Dimensions, PointsBesideTheShapeAreLeftOut) {
  std::mt19937_64 random(8);
  std::normal_distribution<double> normal;
  ScannedPoints points = turn_of([](double) { return 40.0; }, 36, none, [&] { return 0.01 * normal(random); });
  for (Eigen::Index i = 0; i < points.p_mm.cols(); i += 10) points.p_mm.col(i).head<2>() *= 1.05;
  const auto found = dimensions_of(RoundShape::cylinder, points, sure_calibration());
  ASSERT_TRUE(found) << found.error();
  EXPECT_NEAR(found->values[0].value, 80, 0.003);
  EXPECT_NEAR(found->left_out, 0.1, 0.01);
}

TEST(Dimensions, TooLittleIsRefused) {
  const auto round = [](double) { return 40.0; };
  EXPECT_NE(dimensions_of(RoundShape::cylinder, turn_of(round, 11, none, none), sure_calibration()).error().find("11"),
            std::string::npos);
  EXPECT_NE(
      dimensions_of(RoundShape::sphere, turn_of(round, 1, none, none), sure_calibration()).error().find("21 points"),
      std::string::npos);
  // A strip of one degree says nothing of where the axis is.
  ScannedPoints strip = turn_of(round, 24, none, none);
  std::mt19937_64 random(9);
  std::normal_distribution<double> normal;
  for (Eigen::Index i = 0; i < strip.p_mm.cols(); ++i) {
    const double angle = 0.02 * static_cast<double>(i % 24) / 24;
    strip.p_mm.col(i) =
        Vector3d((40 + 0.01 * normal(random)) * std::cos(angle), 40 * std::sin(angle), strip.p_mm(2, i));
  }
  const auto found = dimensions_of(RoundShape::cylinder, strip, sure_calibration());
  if (found) {
    EXPECT_GT(found->values[0].u, 1);
  }
}

}  // namespace
}  // namespace celadon
