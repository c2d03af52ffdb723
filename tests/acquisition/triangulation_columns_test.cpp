// Lines along the columns of the image. Truth: cv::projectPoints, the camera before it was turned, Monte Carlo.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numbers>
#include <random>
#include <vector>

#include "acquisition/laser_line.h"
#include "acquisition/triangulation.h"
#include "tests/acquisition/projection_truth.h"
#include "tests/acquisition/sample_spread.h"
#include "tests/acquisition/synthetic_line.h"
#include "tests/acquisition/test_calibration.h"
#include "tests/acquisition/turned_camera.h"

namespace celadon {
namespace {

const ScanVolume kWholeSpace{.r_min_mm = 1e-6, .r_max_mm = 1e5, .z_min_mm = -1e5, .z_max_mm = 1e5};

LineRow column_at(double y_px, double sigma_px = 0.2) {
  return {.x_px = static_cast<float>(y_px),
          .sigma_px = static_cast<float>(sigma_px),
          .amplitude = 100,
          .width_px = 2,
          .status = RowStatus::found};
}

TEST(TriangulationAlongColumns, TheCalibrationSaysHowTheLineLies) {
  const Calibration upright = test_calibration(), lying = turned(upright);
  for (std::size_t laser = 0; laser < 2; ++laser) {
    EXPECT_EQ(line_along(upright.lasers[laser]), LineAlong::rows);
    EXPECT_EQ(line_along(lying.lasers[laser]), LineAlong::columns);
  }
}

// Of the turned camera each sample has a row, an instant and a table angle of its own.
TEST(TriangulationAlongColumns, RecoversPointsProjectedByOpenCvAtTheInstantOfTheirRow) {
  const Calibration c = turned(test_calibration());
  ASSERT_TRUE(invertible(c.camera_model));
  const ProjectionTruth truth(c);
  for (const int laser : {0, 1}) {
    const Triangulator triangulator(c, laser, kWholeSpace, LineAlong::columns);
    std::vector<LineRow> columns(static_cast<std::size_t>(c.camera_model.width_px));
    for (std::size_t i = 0; i < columns.size(); ++i) {
      columns[i] = column_at(640 + 500 * std::sin(0.004 * static_cast<double>(i)));
    }
    const auto angle = [](std::int64_t t_ns) {
      return AngleAtInstant{0.4 + 1e-9 * static_cast<double>(t_ns), 1e-5, 1.0};
    };
    FrameInfo frame;
    frame.stamp_ns = 5'000'000'000;
    frame.exposure_ns = 8'000'000;
    Profile profile;
    const auto counts = triangulator.triangulate(columns, frame, angle, profile);
    ASSERT_EQ(counts.found, static_cast<int>(columns.size()));
    EXPECT_EQ(profile.time_ns, triangulator.row_instant_ns(frame, 0.5 * (c.camera_model.height_px - 1)));
    double worst = 0;
    for (std::size_t i = 0; i < columns.size(); i += 7) {
      const double y_px = columns[i].x_px;
      const Eigen::Vector3d p_C =
          truth.on_plane(c.lasers[static_cast<std::size_t>(laser)], {static_cast<double>(i), y_px},
                         c.axis.X_CW * Eigen::Vector3d(10, 10, 70));
      const Eigen::Vector3d p_W = c.scale.value * (c.axis.X_CW.inverse() * p_C);
      // The instant and the turn, written out from CALIBRATION.md.
      const double t_ns = 5e9 - 1.5e6 - 0.5 * 8e6 + y_px * 25e3;
      const double turned_rad = -1.0002 * (0.4 + 1e-9 * t_ns);
      const double r = std::hypot(p_W.x(), p_W.y());
      worst = std::max(worst, std::abs(profile.r_mm[i] / r - 1));
      worst = std::max(worst, std::abs(profile.z_mm[i] - p_W.z()) / p_W.norm());
      worst = std::max(worst, std::abs(angle_between(profile.theta_rad[i], std::atan2(p_W.y(), p_W.x()) - turned_rad)) *
                                  std::min(1.0, r / p_W.norm()));
      EXPECT_EQ(profile.row[i], i);
    }
    EXPECT_LT(worst, 1e-9) << "laser " << laser;
  }
}

// From pictures: the same light on the same sensor, whichever way the camera is mounted.
TEST(TriangulationAlongColumns, ATurnedCameraGivesTheSamePoints) {
  Calibration upright = test_calibration();
  upright.time.line_time_ns.value = 0;  // rows of the one are columns of the other: only at one instant are they alike
  const Calibration lying = turned(upright);
  const auto scene = synthetic::nominal_scene();
  const auto picture = synthetic::scan_frame(1280, 1024, scene, 5);
  const auto on = turned(picture.on, 1280, 1024), off = turned(picture.off, 1280, 1024);
  std::vector<LineRow> rows(1024), columns(1024);
  LaserLineExtractor().extract(synthetic::mode_of(1280, 1024), picture.on, picture.off, rows);
  LaserLineExtractor({.along = LineAlong::columns}).extract(synthetic::mode_of(1024, 1280), on, off, columns);
  Profile expected, profile;
  const auto angle = [](std::int64_t) { return AngleAtInstant{0.3, 1e-5, 0.2}; };
  Triangulator(upright, 0, kWholeSpace).triangulate(rows, {}, angle, expected);
  Triangulator(lying, 0, kWholeSpace, LineAlong::columns).triangulate(columns, {}, angle, profile);
  ASSERT_GT(expected.size(), 800u);
  std::size_t compared = 0;
  double squares = 0;
  for (std::size_t i = 0, k = 0; i < expected.size(); ++i) {
    while (k < profile.size() && profile.row[k] < expected.row[i]) ++k;
    if (k == profile.size() || profile.row[k] != expected.row[i]) continue;
    ++compared;
    const double sigma_r = std::sqrt(static_cast<double>(expected.covariance[i].rr));
    const double off_by = (profile.r_mm[k] - expected.r_mm[i]) / sigma_r;
    squares += off_by * off_by;
    EXPECT_NEAR(profile.z_mm[k], expected.z_mm[i], 1.5 * std::sqrt(static_cast<double>(expected.covariance[i].zz)));
    EXPECT_NEAR(angle_between(profile.theta_rad[k], expected.theta_rad[i]), 0,
                1.5 * std::sqrt(static_cast<double>(expected.covariance[i].tt)));
    EXPECT_NEAR(std::sqrt(static_cast<double>(profile.covariance[k].rr)), sigma_r, 0.3 * sigma_r);
  }
  // The search runs from the other end, over other groups of four pixels: it ends where the light is.
  std::printf("a turned camera: %.3f sigma rms apart\n", std::sqrt(squares / static_cast<double>(compared)));
  EXPECT_LT(std::sqrt(squares / static_cast<double>(compared)), 0.2);
  EXPECT_GE(compared, expected.size() - 5);
}

TEST(TriangulationAlongColumns, CovarianceAgreesWithMonteCarlo) {
  const Calibration c = turned(test_calibration());
  ASSERT_GT(c.time.line_time_ns.value, 0);
  const Triangulator triangulator(c, 1, kWholeSpace, LineAlong::columns);
  // So fast a table that the row's instant counts: 0.3 px are 7.5 microseconds.
  constexpr double kSigmaPx = 0.3, kSpeed = -20;
  const auto turning = [](std::int64_t t_ns) {
    return AngleAtInstant{kSpeed * 1e-9 * static_cast<double>(t_ns), 0, kSpeed};
  };
  std::vector<LineRow> nominal(static_cast<std::size_t>(c.camera_model.width_px));
  for (const std::size_t i : {200u, 201u, 202u, 600u, 601u, 602u}) {
    nominal[i] = column_at(300 + 0.5 * static_cast<double>(i), kSigmaPx);
  }
  Profile expected, drawn;
  triangulator.triangulate(nominal, {}, turning, expected);
  ASSERT_GE(expected.size(), 2u);
  std::mt19937_64 random(19);
  std::normal_distribution<double> normal;
  SampleSpread spread(expected);
  constexpr int kTrials = 20'000;
  for (int trial = 0; trial < kTrials; ++trial) {
    std::vector<LineRow> columns = nominal;
    for (LineRow& column : columns) {
      if (column.x_px >= 0) column.x_px += static_cast<float>(kSigmaPx * normal(random));
    }
    triangulator.triangulate(columns, {}, turning, drawn);
    spread.add(drawn);
  }
  spread.expect_as_stated();
}

}  // namespace
}  // namespace celadon
