// Truth: cv::projectPoints, which shares no code with acquisition.
#include "acquisition/triangulation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "tests/acquisition/projection_truth.h"
#include "tests/acquisition/sample_spread.h"
#include "tests/acquisition/test_calibration.h"

namespace celadon {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;

LineRow row_at(float x_px, float sigma_px = 0.2f) {
  return {.x_px = x_px, .sigma_px = sigma_px, .amplitude = 100, .width_px = 2, .status = RowStatus::found};
}

const ScanVolume kEverything{.r_min_mm = 1e-6, .r_max_mm = 1e5, .z_min_mm = -1e5, .z_max_mm = 1e5};

TEST(Triangulation, recovers_points_projected_by_opencv) {
  for (const int laser : {0, 1}) {
    const Calibration c = test_calibration();
    const ProjectionTruth truth(c);
    const LaserPlane& plane = c.lasers[static_cast<std::size_t>(laser)];
    const Triangulator triangulator(c, laser, kEverything);
    std::mt19937 random(3);
    std::uniform_real_distribution<double> radius(5, 60), jitter(-1, 1);
    // A line that wanders smoothly over the whole image, so that no jump cuts it.
    std::vector<LineRow> rows(1024);
    const double centre = 640 + 200 * jitter(random);
    for (std::size_t i = 0; i < rows.size(); ++i) {
      rows[i] = row_at(static_cast<float>(centre + 380 * std::sin(0.004 * static_cast<double>(i))));
    }
    const auto angle = [](std::int64_t t_ns) {
      return AngleAtInstant{0.4 + 1e-9 * static_cast<double>(t_ns), 1e-5, 1.0};
    };
    FrameInfo frame;
    frame.stamp_ns = 5'000'000'000;
    frame.exposure_ns = 8'000'000;
    Profile profile;
    const auto counts = triangulator.triangulate(rows, frame, angle, profile);
    ASSERT_EQ(counts.found, 1024);
    ASSERT_EQ(profile.size(), 1024u);
    double worst = 0;
    for (std::size_t i = 0; i < rows.size(); i += 5) {
      const Eigen::Vector3d p_C =
          truth.on_plane(plane, {rows[i].x_px, static_cast<double>(i)}, c.axis.X_CW * Eigen::Vector3d(10, 10, 70));
      const Eigen::Vector3d p_W = c.scale.value * (c.axis.X_CW.inverse() * p_C);
      // The instant and the turn, written out from CALIBRATION.md.
      const double t_ns = 5e9 - 1.5e6 - 0.5 * 8e6 + static_cast<double>(i) * 25e3;
      const double turned = -1.0002 * (0.4 + 1e-9 * t_ns);
      const double r = std::hypot(p_W.x(), p_W.y());
      worst = std::max(worst, std::abs(profile.r_mm[i] / r - 1));
      worst = std::max(worst, std::abs(profile.z_mm[i] - p_W.z()) / p_W.norm());
      worst = std::max(worst, std::abs(angle_between(profile.theta_rad[i], std::atan2(p_W.y(), p_W.x()) - turned)) *
                                  std::min(1.0, r / p_W.norm()));
      EXPECT_GE(profile.theta_rad[i], 0);
      EXPECT_LT(profile.theta_rad[i], kTurn);
      EXPECT_EQ(profile.row[i], i);
    }
    EXPECT_LT(worst, 1e-9) << "laser " << laser;
  }
}

TEST(Triangulation, undistortion_returns_to_the_pixel_over_the_whole_image) {
  for (const auto& k :
       {std::array<double, 5>{-0.21, 0.13, 8e-4, -5e-4, -0.02}, std::array<double, 5>{0.3, 0.1, 2e-3, 1e-3, 0},
        std::array<double, 5>{-0.35, 0.15, 0, 0, -0.03}, std::array<double, 5>{}}) {
    Calibration c = test_calibration();
    for (std::size_t i = 0; i < 5; ++i) c.camera_model.distortion[i].value = k[i];
    ASSERT_TRUE(invertible(c.camera_model));
    const Lens lens(c.camera_model);
    const ProjectionTruth truth(c);
    for (double y = 0; y < 1024; y += 93) {
      for (double x = 0; x < 1280; x += 31.5) {
        const UndistortedPoint ray = lens.undistort(x, y);
        EXPECT_LT((truth.pixel({ray.a, ray.b, 1}) - Eigen::Vector2d(x, y)).norm(), 1e-6);
        const UndistortedPoint right = lens.undistort(x + 1e-3, y), left = lens.undistort(x - 1e-3, y);
        EXPECT_NEAR(ray.a_by_x, (right.a - left.a) / 2e-3, 1e-9);
        EXPECT_NEAR(ray.b_by_x, (right.b - left.b) / 2e-3, 1e-9);
        const UndistortedPoint below = lens.undistort(x, y + 1e-3), above = lens.undistort(x, y - 1e-3);
        EXPECT_NEAR(ray.a_by_y, (below.a - above.a) / 2e-3, 1e-9);
        EXPECT_NEAR(ray.b_by_y, (below.b - above.b) / 2e-3, 1e-9);
      }
    }
  }
}

TEST(Triangulation, direction_and_encoder_scale_turn_the_samples_back) {
  // A marker fixed on the table passes the laser plane again and again: whatever the direction, one marker has one
  // theta.
  for (const double direction : {1.0, -1.0}) {
    Calibration c = test_calibration();
    c.encoder.direction = direction;
    c.time.line_time_ns.value = 0;
    const Triangulator triangulator(c, 0, kEverything);
    std::vector<LineRow> rows(1024);
    for (std::size_t i = 400; i < 420; ++i) rows[i] = row_at(600.f);
    Profile at_zero, at_turn;
    triangulator.triangulate(
        rows, {}, [](std::int64_t) { return AngleAtInstant{}; }, at_zero);
    triangulator.triangulate(
        rows, {},
        [](std::int64_t) {
          return AngleAtInstant{0.25, 0, 0};
        },
        at_turn);
    ASSERT_EQ(at_zero.size(), 20u);
    // The table turned counter-clockwise by 0.25 * 1.0002 (direction +1): what the laser now hits lies clockwise on it.
    for (std::size_t i = 0; i < 20; ++i) {
      EXPECT_NEAR(angle_between(at_turn.theta_rad[i], at_zero.theta_rad[i]), -direction * 0.25 * 1.0002, 1e-12);
    }
    EXPECT_NEAR(at_turn.table_angle_rad, direction * 0.25 * 1.0002, 1e-15);
  }
}

TEST(Triangulation, what_the_encoder_errs_by_once_a_turn_is_taken_off) {
  Calibration c = test_calibration();
  c.encoder.cos_rad.value = 3e-3;
  c.encoder.sin_rad.value = -2e-3;
  c.time.line_time_ns.value = 4000;
  const Triangulator triangulator(c, 0, kEverything);
  std::vector<LineRow> rows(1024);
  for (const std::size_t i :
       {std::size_t{300}, std::size_t{301}, std::size_t{302}, std::size_t{800}, std::size_t{801}, std::size_t{802}}) {
    rows[i] = row_at(600.f);
  }
  Profile at_zero, moving;
  triangulator.triangulate(
      rows, {}, [](std::int64_t) { return AngleAtInstant{}; }, at_zero);
  // 3 rad/s: from the first to the last row a hundredth of a radian.
  const auto encoder_at = [](std::int64_t ns) { return 2.1 + 3e-9 * static_cast<double>(ns); };
  triangulator.triangulate(
      rows, {},
      [&](std::int64_t ns) {
        return AngleAtInstant{encoder_at(ns), 0, 3};
      },
      moving);
  ASSERT_GE(at_zero.size(), 2u);
  ASSERT_EQ(moving.size(), at_zero.size());
  for (std::size_t i = 0; i < moving.size(); ++i) {
    const double b = encoder_at(triangulator.row_instant_ns({}, moving.row[i]));
    const double table_rad = -(1.0002 * b + 3e-3 * (std::cos(b) - 1) - 2e-3 * std::sin(b));  // direction -1
    EXPECT_NEAR(angle_between(moving.theta_rad[i], at_zero.theta_rad[i]), -table_rad, 1e-8) << i;
  }
}

TEST(Triangulation, covariance_agrees_with_monte_carlo) {
  Calibration c = test_calibration();
  c.time.line_time_ns.value = 0;
  const Triangulator triangulator(c, 1, kEverything);
  constexpr double kSigmaPx = 0.3, kSigmaAngle = 2e-4, kSpeed = 0.21;
  FrameInfo frame;
  frame.exposure_ns = 4'000'000;
  const double smear = kSpeed * 4e-3;
  std::vector<LineRow> nominal(1024);
  const std::vector<std::size_t> where{100, 101, 102, 500, 501, 502, 900, 901, 902};
  for (const std::size_t i : where) {
    nominal[i] = row_at(400.f + 0.5f * static_cast<float>(i), static_cast<float>(kSigmaPx));
  }
  Profile expected;
  const auto quiet = [&](std::int64_t) { return AngleAtInstant{1.0, kSigmaAngle, kSpeed}; };
  triangulator.triangulate(nominal, frame, quiet, expected);
  // Only the middle row of each run: its neighbours lie at gaps.
  ASSERT_EQ(expected.size(), 5u);

  std::mt19937_64 random(17);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> window(-0.5, 0.5);
  SampleSpread spread(expected);
  constexpr int kTrials = 20'000;
  Profile drawn;
  for (int trial = 0; trial < kTrials; ++trial) {
    std::vector<LineRow> rows = nominal;
    for (const std::size_t i : where) rows[i].x_px += static_cast<float>(kSigmaPx * normal(random));
    // Light from one moment of the exposure, read with one error of the angle.
    const double angle = 1.0 + kSigmaAngle * normal(random) + smear * window(random);
    triangulator.triangulate(
        rows, frame,
        [&](std::int64_t) {
          return AngleAtInstant{angle, 0, 0};
        },
        drawn);
    spread.add(drawn);
  }
  spread.expect_as_stated();
}

TEST(Triangulation, rows_beside_jumps_and_gaps_are_dropped_and_counted) {
  Calibration c = test_calibration();
  const Triangulator triangulator(c, 0, kEverything);
  const auto angle = [](std::int64_t) { return AngleAtInstant{}; };
  std::vector<LineRow> rows(1024);
  for (std::size_t i = 0; i < rows.size(); ++i) rows[i] = row_at(i < 300 ? 500.f : 560.f);  // a jump at 299 | 300
  rows[100].status = RowStatus::no_line;                                                    // a dropout is no edge
  for (std::size_t i = 700; i < 710; ++i) rows[i].status = RowStatus::no_line;              // a gap is
  rows[800].status = RowStatus::ambiguous;
  rows[801].status = RowStatus::saturated;
  rows[802].x_px = 5000;  // outside the image: not a position
  Profile profile;
  const auto counts = triangulator.triangulate(rows, {}, angle, profile);
  EXPECT_EQ(counts.edge, 4);
  EXPECT_EQ(counts.ambiguous, 1);
  EXPECT_EQ(counts.outside, 0);
  EXPECT_EQ(counts.found, 1024 - 1 - 10 - 4 - 1 - 1);
  for (const std::uint16_t row : profile.row) {
    EXPECT_TRUE(row != 299 && row != 300 && row != 699 && row != 710 && row != 800 && row != 802) << row;
  }
  // A line as steep as 30 px a row is whole, and one wild row costs itself and its two neighbours.
  for (std::size_t i = 0; i < rows.size(); ++i) rows[i] = {};
  for (std::size_t i = 0; i < 40; ++i) rows[i] = row_at(20 + 30.f * static_cast<float>(i));
  EXPECT_EQ(triangulator.triangulate(rows, {}, angle, profile).edge, 0);
  for (std::size_t i = 0; i < 40; ++i) rows[i] = row_at(600.f);
  rows[20] = row_at(700.f);
  EXPECT_EQ(triangulator.triangulate(rows, {}, angle, profile).edge, 3);
}

TEST(Triangulation, samples_outside_the_volume_or_without_angle_are_counted) {
  Calibration c = test_calibration();
  std::vector<LineRow> rows(1024, row_at(640.f));
  Profile profile;
  const Triangulator all(c, 0, kEverything);
  const auto angle = [](std::int64_t) { return AngleAtInstant{}; };
  ASSERT_EQ(all.triangulate(rows, {}, angle, profile).found, 1024);
  const double z_low = 0.5 * (profile.z_mm[600] + profile.z_mm[601]),
               z_high = 0.5 * (profile.z_mm[200] + profile.z_mm[201]);
  ASSERT_LT(z_low, z_high);
  const Triangulator some(c, 0, {.r_min_mm = 1e-6, .r_max_mm = 1e5, .z_min_mm = z_low, .z_max_mm = z_high});
  const auto counts = some.triangulate(rows, {}, angle, profile);
  EXPECT_EQ(counts.found, 400);
  EXPECT_EQ(counts.outside, 624);

  const auto none = [](std::int64_t) -> tl::expected<AngleAtInstant, const char*> {
    return tl::unexpected<const char*>("unknown");
  };
  const auto without = some.triangulate(rows, {}, none, profile);
  EXPECT_EQ(without.found, 0);
  EXPECT_EQ(without.no_angle, 400);
  EXPECT_EQ(profile.size(), 0u);
  EXPECT_THROW(Triangulator(c, 7, kEverything), std::invalid_argument);
  EXPECT_THROW(Triangulator(c, 0, {.r_min_mm = 5, .r_max_mm = 4}), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
