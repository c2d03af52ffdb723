// What a pinhole camera sees of a board in known poses: appearance and advice.
#include "acquisition/calibrate/view_planner.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <random>

namespace celadon {
namespace {

using Eigen::Vector3d;

constexpr int kWidth = 1280, kHeight = 1024;
constexpr double kFocal_px = 2000, kDegree = std::numbers::pi / 180;

/// Corners of the board with its middle at p, turned about the camera's x, y and z axes.
std::vector<SeenCorner> seen(const TargetBoard& board, const Vector3d& p, double about_x, double about_y,
                             double about_z) {
  const Eigen::Matrix3d R = (Eigen::AngleAxisd(about_x * kDegree, Vector3d::UnitX()) *
                             Eigen::AngleAxisd(about_y * kDegree, Vector3d::UnitY()) *
                             Eigen::AngleAxisd(about_z * kDegree, Vector3d::UnitZ()))
                                .toRotationMatrix();
  std::vector<SeenCorner> out;
  for (const BoardCorner& c : board.corners()) {
    const Vector3d q = R * Vector3d(c.p_mm.x(), c.p_mm.y(), 0) + p;
    out.push_back({c.id, Eigen::Vector2d(640, 512) + kFocal_px * q.hnormalized(), 0.03});
  }
  return out;
}

const TargetBoard& board() {
  static const TargetBoard b(10, 7, 8, false);
  return b;
}

TEST(BoardAppearance, IsThatOfTheKnownPose) {
  const BoardAppearance a = appearance_of(board(), seen(board(), {15, -20, 300}, 0, 0, 25));
  EXPECT_NEAR(a.middle_px.x(), 640 + 2000 * 15 / 300., 1e-4);
  EXPECT_NEAR(a.middle_px.y(), 512 - 2000 * 20 / 300., 1e-4);
  EXPECT_NEAR(a.px_per_mm, 2000 / 300., 0.01 * 2000 / 300.);
  EXPECT_NEAR(a.roll_rad, 25 * kDegree, 1e-6);
  EXPECT_LT(a.tilt_rad.norm(), 1e-3);
}

// Turned about the y axis by a positive angle, z = -x sin(angle): the right edge comes nearer. About x, z = y
// sin(angle): the upper one does.
TEST(BoardAppearance, TiltsTowardsTheEdgeThatIsNearer) {
  const auto tilt = [](double about_x, double about_y, double about_z) -> Eigen::Vector2d {
    return appearance_of(board(), seen(board(), {0, 0, 300}, about_x, about_y, about_z)).tilt_rad / kDegree;
  };
  for (const double angle : {12., 30., 50.}) {
    EXPECT_NEAR((tilt(0, angle, 0) - Eigen::Vector2d(angle, 0)).norm(), 0, 1) << angle;
    EXPECT_NEAR((tilt(0, -angle, 0) - Eigen::Vector2d(-angle, 0)).norm(), 0, 1) << angle;
    EXPECT_NEAR((tilt(angle, 0, 0) - Eigen::Vector2d(0, -angle)).norm(), 0, 1) << angle;
    EXPECT_NEAR((tilt(-angle, 0, 70) - Eigen::Vector2d(0, angle)).norm(), 0, 1) << "rolled";
  }
}

TEST(ViewPlanner, TakesNoViewTwice) {
  ViewPlanner planner(board(), kWidth, kHeight, 10);
  const auto first = seen(board(), {0, 0, 300}, 10, 0, 0);
  EXPECT_TRUE(planner.is_new(first));
  planner.add(first);
  EXPECT_FALSE(planner.is_new(first));
  EXPECT_FALSE(planner.is_new(seen(board(), {1, 1, 302}, 11, 1, 1)));
  EXPECT_TRUE(planner.is_new(seen(board(), {25, 0, 300}, 10, 0, 0)));
  EXPECT_TRUE(planner.is_new(seen(board(), {0, 0, 350}, 10, 0, 0)));
  EXPECT_TRUE(planner.is_new(seen(board(), {0, 0, 300}, 30, 0, 0)));
  EXPECT_TRUE(planner.is_new(seen(board(), {0, 0, 300}, 10, 0, 40)));
}

TEST(ViewPlanner, AsksForWhatIsMissingUntilNothingIs) {
  ViewPlanner planner(board(), kWidth, kHeight, 8);
  for (int i = 0; i < 9; ++i) {
    EXPECT_NE(planner.advice().find("left edge comes nearer"), std::string::npos) << planner.advice();
    planner.add(seen(board(), {0, 0, 300 + 10. * i}, 0, 0, 0));
  }
  EXPECT_FALSE(planner.complete());
  for (const double sign : {-1., 1.}) {
    for (int i = 0; i < 2; ++i) planner.add(seen(board(), {0, 0, 320 + 30. * i}, 0, sign * 25, 0));
    for (int i = 0; i < 2; ++i) planner.add(seen(board(), {0, 0, 320 + 30. * i}, sign * 25, 0, 0));
  }
  EXPECT_NE(planner.advice().find("corner of the picture"), std::string::npos) << planner.advice();
  for (const double x : {-60., 0., 60.}) {
    for (const double y : {-50., 0., 50.}) planner.add(seen(board(), {x, y, 300}, 0, 0, 0));
  }
  EXPECT_EQ(planner.advice(), "");
  EXPECT_TRUE(planner.complete());
}

// Whoever follows the advice from anywhere comes to an end.
TEST(ViewPlanner, EndsWithRandomViewsToo) {
  std::mt19937 random(5);
  const auto uniform = [&](double low, double high) { return std::uniform_real_distribution(low, high)(random); };
  ViewPlanner planner(board(), kWidth, kHeight, 12);
  int looks = 0;
  for (; looks < 1000 && !planner.complete(); ++looks) {
    const auto now = seen(board(), {uniform(-60, 60), uniform(-50, 50), uniform(260, 400)}, uniform(-40, 40),
                          uniform(-40, 40), uniform(-180, 180));
    if (planner.is_new(now)) planner.add(now);
  }
  EXPECT_TRUE(planner.complete());
  EXPECT_GE(planner.views(), 12);
  EXPECT_LE(planner.views(), 24);
}

}  // namespace
}  // namespace celadon
