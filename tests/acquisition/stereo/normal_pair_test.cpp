// Normal images against the paper's closed form and against OpenCV's projection.

#include "acquisition/stereo/normal_pair.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "tests/acquisition/projection_truth.h"
#include "tests/acquisition/test_calibration.h"

namespace celadon {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kFirst_rad = 0.83;

Vector3d turned(const Vector3d& p, double angle_rad) {
  return Eigen::AngleAxisd(angle_rad, Vector3d::UnitZ()) * p;
}

/// What the camera shows of a point of the object (true mm) with the table at an encoder's angle.
Vector2d seen(const Calibration& c, const Vector3d& p_O, double encoder_rad) {
  const double table_rad = c.encoder.direction * c.encoder.scale.value * encoder_rad;
  return ProjectionTruth(c).pixel(c.axis.X_CW * turned(p_O / c.scale.value, table_rad));
}

std::vector<Vector3d> points(int count) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> across(-45, 45), up(5, 120);
  std::vector<Vector3d> out;
  for (int i = 0; i < count; ++i) out.emplace_back(across(random), across(random), up(random));
  return out;
}

NormalPair pair_of(const Calibration& c, double first_rad, double second_rad) {
  auto pair = NormalPair::make(c, first_rad, second_rad);
  EXPECT_TRUE(pair) << pair.error();
  return *pair;
}

TEST(NormalPair, APointHasOneRowAndItsDisparityTellsWhereItIs) {
  const Calibration c = test_calibration();
  for (const double turn : {0.14, -0.14, 0.02, 0.4}) {
    const NormalPair pair = pair_of(c, kFirst_rad, kFirst_rad + turn);
    for (const Vector3d& p : points(200)) {
      const Vector2d first = pair.normal(0, seen(c, p, kFirst_rad)),
                     second = pair.normal(1, seen(c, p, kFirst_rad + turn));
      EXPECT_NEAR(first.y(), second.y(), 1e-7);
      const StereoPoint found = pair.point(first.x(), first.y(), first.x() - second.x());
      const Vector3d in_object = p;  // at the table's angle 0
      EXPECT_LT((found.p_mm - in_object).norm(), 1e-6) << turn;
    }
  }
}

TEST(NormalPair, PixelsAreTheInverseOfNormalPlaces) {
  const Calibration c = test_calibration();
  const NormalPair pair = pair_of(c, 0, 0.14);
  for (const std::size_t k : {0u, 1u}) {
    for (const Vector2d& place : {Vector2d(100, 200), Vector2d(640, 512), Vector2d(1100, 900)}) {
      const Vector2d pixel = pair.pixel(k, place.x(), place.y());
      EXPECT_LT((pair.normal(k, pixel) - place).norm(), 1e-7);
    }
  }
}

// Equations (4) to (7) of the paper, whose camera looks straight at the axis. Its image coordinates run against ours
// (an image behind the lens), so that its left picture is our right one.
TEST(NormalPair, IsThePapersForALevelCamera) {
  Calibration c = test_calibration();
  const double f = 1400;
  c.camera_model.fx_px = c.camera_model.fy_px = {f, 0};
  for (Measured& k : c.camera_model.distortion) k = {0, 0};
  c.axis.X_CW = looking_at({300, 0, 60}, {0, 0, 60});
  c.encoder.scale = {1, 0};
  c.encoder.direction = 1;
  const double phi = 0.12;
  const NormalPair pair = pair_of(c, 0, phi);
  const double cx = c.camera_model.cx_px.value, cy = c.camera_model.cy_px.value;
  // The middle of the original picture is cos(phi/2)-wise off the middle of the normal one.
  const Vector2d origin = pair.normal(0, {cx, cy}), other = pair.normal(1, {cx, cy});
  const double half = phi / 2, shift = f * std::tan(half);
  for (const Vector2d& at : {Vector2d(300, 100), Vector2d(640, 512), Vector2d(1000, 900)}) {
    const double x = at.x() - cx, y = at.y() - cy;
    const double plus = f * (x * std::cos(half) + f * std::sin(half)) / (f * std::cos(half) - x * std::sin(half)),
                 minus = f * (x * std::cos(half) - f * std::sin(half)) / (f * std::cos(half) + x * std::sin(half)),
                 y_plus = y * f / (f * std::cos(half) - x * std::sin(half)),
                 y_minus = y * f / (f * std::cos(half) + x * std::sin(half));
    const Vector2d first = pair.normal(0, at) - origin, second = pair.normal(1, at) - other;
    // The first camera stands to the right of the second: it looks to the left.
    EXPECT_NEAR(first.x(), minus + shift, 1e-8);
    EXPECT_NEAR(first.y(), y_minus, 1e-8);
    EXPECT_NEAR(second.x(), plus - shift, 1e-8);
    EXPECT_NEAR(second.y(), y_plus, 1e-8);
  }
  EXPECT_NEAR(pair.baseline_mm(), 2 * 300 * std::sin(half), 1e-9);  // b = 2 d sin(phi / 2)
}

TEST(NormalPair, DerivativesAreThoseOfThePoint) {
  const Calibration c = test_calibration();
  const double second_rad = kFirst_rad + 0.14, turn = c.encoder.direction * c.encoder.scale.value;
  for (const Vector3d& p : points(30)) {
    const Vector2d pixel_1 = seen(c, p, kFirst_rad), pixel_2 = seen(c, p, second_rad);
    const auto found = [&](double first, double second, double more_px) {
      const NormalPair moved = pair_of(c, first, second);
      const Vector2d a = moved.normal(0, pixel_1), b = moved.normal(1, pixel_2);
      return moved.point(a.x(), a.y(), a.x() - b.x() + more_px);
    };
    const StereoPoint at = found(kFirst_rad, second_rad, 0);
    constexpr double kStep_px = 1e-4, kStep_rad = 1e-6;
    const Vector3d by_px =
        (found(kFirst_rad, second_rad, kStep_px).p_mm - found(kFirst_rad, second_rad, -kStep_px).p_mm) / (2 * kStep_px);
    EXPECT_LT((by_px - at.by_disparity).norm(), 1e-5 * by_px.norm());
    const double step = kStep_rad / turn;  // of the encoder
    const Vector3d by_first =
        (found(kFirst_rad + step, second_rad, 0).p_mm - found(kFirst_rad - step, second_rad, 0).p_mm) / (2 * kStep_rad);
    const Vector3d by_second =
        (found(kFirst_rad, second_rad + step, 0).p_mm - found(kFirst_rad, second_rad - step, 0).p_mm) / (2 * kStep_rad);
    // Wrong angles leave rays that miss each other: heights differ by where between them the point is said to be.
    const double size = by_first.norm() + by_second.norm();
    EXPECT_LT((by_first - at.by_first_rad).head<2>().norm(), 0.03 * size);
    EXPECT_LT((by_second - at.by_second_rad).head<2>().norm(), 0.03 * size);
  }
}

TEST(NormalPair, TheAxisHasDisparityNoneAndTheRangeHoldsTheVolume) {
  const Calibration c = test_calibration();
  const NormalPair pair = pair_of(c, 0, 0.14);
  const DisparityRange range = pair.range_to(40);
  EXPECT_LT(range.lowest, 0);
  EXPECT_GT(range.highest, 0);
  for (const Vector3d& p : points(300)) {
    const Vector2d a = pair.normal(0, seen(c, p, 0)), b = pair.normal(1, seen(c, p, 0.14));
    const double disparity = a.x() - b.x();
    const double before = p.dot(turned(c.axis.X_CW.inverse().translation(), 0).normalized());
    if (std::abs(before) > 15 || p.head<2>().norm() > 15) continue;
    EXPECT_GE(disparity, range.lowest);
    EXPECT_LE(disparity, range.highest);
  }
}

TEST(NormalPair, AnglesThatAreNoPairAreRefused) {
  const Calibration c = test_calibration();
  for (const double second : {kFirst_rad, kFirst_rad + 1e-4, kFirst_rad + 1, kFirst_rad - 2}) {
    const auto pair = NormalPair::make(c, kFirst_rad, second);
    ASSERT_FALSE(pair) << second;
    EXPECT_NE(pair.error().find("turn it by"), std::string::npos) << pair.error();
  }
  EXPECT_FALSE(NormalPair::make(c, std::nan(""), 0.1));
}

TEST(NormalPair, ACameraAboveTheAxisIsRefused) {
  Calibration c = test_calibration();
  c.axis.X_CW = looking_at({3, 0, 400}, {3, 1e-3, 0});
  const auto pair = NormalPair::make(c, 0, 0.14);
  ASSERT_FALSE(pair);
  EXPECT_NE(pair.error().find("along the table's axis"), std::string::npos) << pair.error();
}

}  // namespace
}  // namespace celadon
