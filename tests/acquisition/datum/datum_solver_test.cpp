// Table, camera and clocks from fiducials that lie where a disturbed machine shows them, projected by this test.
#include "acquisition/datum/datum_solver.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>
#include <vector>

#include "tests/acquisition/datum/rim_camera.h"

namespace celadon {
namespace {

constexpr double kTurn = 2 * std::numbers::pi, kNoise_px = 0.08, kLittleNoise_px = 0.013;
constexpr double kRunUp = 0.15;

/// What really happens, by how far the table has turned (negative: before the turn).
struct Disturbed {
  std::function<double(double)> table_rad = [](double) { return 0.; };
  std::function<Eigen::Isometry3d(double)> X_CC = [](double) { return Eigen::Isometry3d::Identity(); };
};

const Calibration& machine() {
  static const Calibration calibration = testing::RimCamera("empty").truth();
  return calibration;
}

// Pinhole and Brown-Conrady by hand: this test's own.
Eigen::Vector2d pixel_of(const Eigen::Vector3d& p) {
  const CameraModel& c = machine().camera_model;
  const double a = p.x() / p.z(), b = p.y() / p.z(), s = a * a + b * b;
  const double g = 1 + s * (c.distortion[0].value + s * (c.distortion[1].value + s * c.distortion[4].value));
  const double p1 = c.distortion[2].value, p2 = c.distortion[3].value;
  return {c.fx_px.value * (a * g + 2 * p1 * a * b + p2 * (s + 2 * a * a)) + c.cx_px.value,
          c.fy_px.value * (b * g + p1 * (s + 2 * b * b) + 2 * p2 * a * b) + c.cy_px.value};
}

std::vector<DatumSighting> seen_of(const Disturbed& really, unsigned seed, double strays = 0,
                                   double noise_px = kNoise_px) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> share(0, 1);
  std::vector<DatumSighting> out;
  const Calibration& c = machine();
  for (int k = -1; k < 360; ++k) {
    const double turned = k < 0 ? -kRunUp : kTurn * k / 360, angle = 0.7 + turned;
    for (std::size_t tag = 0; tag < c.rim_tags.size(); ++tag) {
      Eigen::Vector3d middle = Eigen::Vector3d::Zero();
      for (const auto& corner : c.rim_tags[tag].corners_mm) middle += corner / 4;
      const auto at = [&](double a) -> Eigen::Vector3d {
        return c.axis.X_CW * (Eigen::AngleAxisd(a, Eigen::Vector3d::UnitZ()) * middle);
      };
      if ((Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()) * middle).dot(c.axis.X_CW.inverse().translation()) < 0)
        continue;  // behind the object
      TagSighting sighting{tag, angle, {}, Eigen::Matrix2d::Identity() / (noise_px * noise_px)};
      sighting.shift_px = pixel_of(really.X_CC(turned) * at(angle + really.table_rad(turned))) - pixel_of(at(angle)) +
                          noise_px * Eigen::Vector2d(normal(random), normal(random));
      if (share(random) < strays) sighting.shift_px += Eigen::Vector2d(5, -4);
      out.push_back({sighting, turned});
    }
  }
  return out;
}

TEST(Datum, ASoundMachineShowsNothing) {
  const auto reading = read_datum(machine(), seen_of({}, 1));
  ASSERT_TRUE(reading);
  EXPECT_LE(std::abs(reading->turn_error_rad), 4 * reading->turn_sd_rad);
  EXPECT_LE(reading->turn_sd_rad, 3e-4);
  EXPECT_LE(reading->camera_px, 0.06);
  ASSERT_TRUE(reading->start_error_rad);
  EXPECT_LE(std::abs(*reading->start_error_rad), 4 * reading->start_sd_rad);
  EXPECT_NEAR(reading->residual_px, kNoise_px, 0.01);
}

TEST(Datum, TellsWrongSteps) {
  Disturbed really;
  really.table_rad = [](double turned) { return -0.01 * (turned + kRunUp); };
  const auto reading = read_datum(machine(), seen_of(really, 2));
  ASSERT_TRUE(reading);
  EXPECT_NEAR(reading->turn_error_rad, -0.01 * kTurn, 4 * reading->turn_sd_rad + 1e-4);
  EXPECT_LE(reading->wander_rad, 1e-3);
  // Wrong in the run-up, too: no sign of frames that are late.
  EXPECT_LE(std::abs(*reading->start_error_rad), 4 * reading->start_sd_rad);
  EXPECT_LE(reading->camera_px, 0.3);
}

TEST(Datum, TellsATableThatSlips) {
  Disturbed really;
  really.table_rad = [](double turned) { return turned > 3 ? -0.035 : 0.; };
  const auto reading = read_datum(machine(), seen_of(really, 3));
  ASSERT_TRUE(reading);
  EXPECT_NEAR(reading->turn_error_rad, -0.035, 4e-4);
  EXPECT_GT(reading->wander_rad, 0.012);
}

// The better the light, the smaller is what counts as far off; the slip itself must not.
TEST(Datum, TellsASlipInGoodLight) {
  Disturbed really;
  really.table_rad = [](double turned) { return turned > 3.11 ? -0.035 : 0.; };
  const auto reading = read_datum(machine(), seen_of(really, 7, 0, kLittleNoise_px));
  ASSERT_TRUE(reading);
  EXPECT_NEAR(reading->turn_error_rad, -0.035, 2e-4);
  EXPECT_LE(reading->camera_px, 0.25);
}

TEST(Datum, TellsFramesThatAreLate) {
  Disturbed really;
  really.table_rad = [](double turned) { return turned < 0 ? 0 : 0.6e-3; };  // 1 ms at 0.6 rad/s
  const auto reading = read_datum(machine(), seen_of(really, 4));
  ASSERT_TRUE(reading && reading->start_error_rad);
  EXPECT_NEAR(*reading->start_error_rad, 0.6e-3, 4 * reading->start_sd_rad);
  EXPECT_LE(reading->start_sd_rad, 2e-4);
  EXPECT_LE(std::abs(reading->turn_error_rad), 4 * reading->turn_sd_rad);
}

RC_GTEST_PROP(Datum, TellsACameraThatMoved, ()) {
  const auto some = [](const char*) { return 0.002 * (*rc::gen::inRange(-1000, 1001) / 1000.); };
  const Eigen::Vector3d turn(some("x"), some("y"), 0);
  RC_PRE(turn.norm() > 5e-4);
  Disturbed really;
  const Eigen::Isometry3d nudge(Eigen::AngleAxisd(turn.norm(), turn.normalized()));
  const bool later = *rc::gen::arbitrary<bool>();
  really.X_CC = [&](double turned) { return later && turned < 3 ? Eigen::Isometry3d::Identity() : nudge; };
  const auto reading = read_datum(machine(), seen_of(really, 5, 0.02));
  RC_ASSERT(reading.has_value());
  // How far the middle of the front rim moves in the picture; tags all round move about as much.
  const Calibration& c = machine();
  const Eigen::Vector3d front = c.axis.X_CW * Eigen::Vector3d(0, 0, 0);
  const double moved_px = (pixel_of(nudge * front) - pixel_of(front)).norm();
  RC_ASSERT(std::abs(reading->camera_px - moved_px) <= 0.35 * moved_px + 0.25);
  RC_ASSERT(std::abs(reading->turn_error_rad) <= 5e-4 + 4 * reading->turn_sd_rad);
  if (later) RC_ASSERT(reading->camera_first_px <= 0.1 + 0.1 * moved_px);
}

TEST(Datum, TooFewSightingsSayNothing) {
  EXPECT_FALSE(read_datum(machine(), {}));
  std::vector<DatumSighting> few = seen_of({}, 6);
  few.resize(20);
  EXPECT_FALSE(read_datum(machine(), few));
}

}  // namespace
}  // namespace celadon
