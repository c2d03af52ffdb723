// Triangulation with the head turned about its elevation axis and the table raised by its lift.

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <numbers>
#include <random>
#include <stdexcept>
#include <vector>

#include "acquisition/triangulation.h"
#include "tests/acquisition/stop_truth.h"
#include "tests/acquisition/test_calibration.h"

namespace celadon {
namespace {

using Eigen::Vector3d;

const ScanVolume kAnywhere{.r_min_mm = 1e-6, .r_max_mm = 1e5, .z_min_mm = -1e5, .z_max_mm = 1e5};
constexpr std::size_t kRow = 512;
constexpr float kColumn_px = 640;

/// A line of one row.
std::vector<LineRow> one_row(float x_px, float sigma_px) {
  std::vector<LineRow> rows(1024);
  rows[kRow] = {.x_px = x_px, .sigma_px = sigma_px, .amplitude = 100, .width_px = 2, .status = RowStatus::found};
  return rows;
}

/// Axes near their nominal places, and a camera without distortion.
Calibration with_axes(std::mt19937_64& random) {
  std::uniform_real_distribution<double> uniform(-1, 1);
  const auto any = [&] { return uniform(random); };
  Calibration c = test_calibration();
  for (Measured& k : c.camera_model.distortion) k.value = 0;
  c.time.line_time_ns.value = 0;
  // The camera looks along -x: right-handed about -y, the head rises.
  const Vector3d elevation_direction = Vector3d(0.05 * any(), -1, 0.05 * any()).normalized();
  const Vector3d lift_direction = Vector3d(0.03 * any(), 0.03 * any(), 1).normalized();
  c.elevation = ElevationAxis{{2 * any(), 2 * any(), 60 + 5 * any()}, elevation_direction, 0, 0, {1 + 0.01 * any(), 0}};
  c.lift = LiftAxis{lift_direction, 0, {1 + 0.01 * any(), 0}};
  return c;
}

/// The calibration with principal point and laser plane so that a camera point is seen at one pixel and lit by laser 0.
Calibration through(Calibration c, const Vector3d& p_C, const Vector3d& normal_C) {
  c.camera_model.cx_px.value = kColumn_px - c.camera_model.fx_px.value * p_C.x() / p_C.z();
  c.camera_model.cy_px.value = static_cast<double>(kRow) - c.camera_model.fy_px.value * p_C.y() / p_C.z();
  c.lasers[0].normal_C = normal_C;
  c.lasers[0].distance_mm = normal_C.dot(p_C);
  return c;
}

Profile triangulated(const Calibration& c, const AxisStop& stop, double table_angle_rad, float x_px = kColumn_px) {
  const double encoder_rad = table_angle_rad / (c.encoder.direction * c.encoder.scale.value);
  Profile profile;
  Triangulator(c, 0, kAnywhere, LineAlong::rows, stop)
      .triangulate(
          one_row(x_px, 0.5f), {},
          [&](std::int64_t) {
            return AngleAtInstant{encoder_rad, 0, 0};
          },
          profile);
  return profile;
}

RC_GTEST_PROP(TriangulationAtStops, a_point_that_was_projected_comes_back, ()) {
  std::mt19937_64 random(*rc::gen::arbitrary<std::uint64_t>());
  std::uniform_real_distribution<double> uniform(-1, 1);
  const Calibration axes = with_axes(random);
  const AxisStop stop{0.7 * uniform(random), 60 * uniform(random)};
  const double theta = std::numbers::pi * uniform(random);
  const Vector3d p_W(40 * uniform(random), 40 * uniform(random), 60 + 50 * uniform(random));
  const Vector3d p_C = seen_at_stop(axes, p_W, theta, stop);
  const Vector3d normal = Vector3d(0.8, 0.3 * uniform(random), -0.5 + 0.2 * uniform(random)).normalized();
  RC_PRE(p_W.head<2>().norm() > 2 && p_C.z() > 100 && std::abs(normal.dot(p_C)) > 20);
  const Calibration c = through(axes, p_C, normal);

  const Profile profile = triangulated(c, stop, theta);
  RC_ASSERT(profile.size() == 1u);
  const double r = profile.r_mm[0], angle = profile.theta_rad[0];
  RC_ASSERT((Vector3d(r * std::cos(angle), r * std::sin(angle), profile.z_mm[0]) - p_W).norm() < 1e-9);

  // The covariance is that of the position along the row, by differences over a 16th of a pixel.
  constexpr float kStep_px = 1.f / 32;
  constexpr double kBySigma = 0.5 / (2 * kStep_px);
  const Profile before = triangulated(c, stop, theta, kColumn_px - kStep_px),
                after = triangulated(c, stop, theta, kColumn_px + kStep_px);
  RC_ASSERT(before.size() == 1u && after.size() == 1u);
  const double dr = kBySigma * (after.r_mm[0] - before.r_mm[0]), dz = kBySigma * (after.z_mm[0] - before.z_mm[0]);
  const double dt = kBySigma * std::remainder(after.theta_rad[0] - before.theta_rad[0], 2 * std::numbers::pi);
  const SampleCovariance& C = profile.covariance[0];
  const auto near = [](double stated, double wanted, double size) { return std::abs(stated - wanted) <= 1e-3 * size; };
  RC_ASSERT(near(C.rr, dr * dr, dr * dr + 1e-6));
  RC_ASSERT(near(C.zz, dz * dz, dz * dz + 1e-6));
  RC_ASSERT(near(C.rt * r, dr * dt * r, std::abs(dr) * std::hypot(dr, dt * r) + 1e-6));
}

TEST(TriangulationAtStops, positive_elevation_raises_the_head_and_the_lift_the_table) {
  Calibration c = test_calibration();
  c.elevation = ElevationAxis{{0, 0, 70}, {0, -1, 0}, 0, 0, {1, 0}};
  c.lift = LiftAxis{};
  const auto camera = [&](const AxisStop& stop) -> Vector3d { return camera_to_object(c, stop).translation(); };
  EXPECT_GT(camera({0.3, 0}).z(), camera({0, 0}).z() + 50);
  // Seen from the object, a raised table is a lowered camera.
  EXPECT_NEAR(camera({0, 25}).z(), camera({0, 0}).z() - 25, 1e-9);
  EXPECT_NEAR((camera({0.3, 25}) - camera({0.3, 0})).z(), -25, 1e-9);
}

TEST(TriangulationAtStops, an_axis_that_is_not_calibrated_cannot_stand_off_0) {
  const Calibration c = test_calibration();
  EXPECT_THROW(Triangulator(c, 0, kAnywhere, LineAlong::rows, AxisStop{0.1, 0}), std::invalid_argument);
  EXPECT_THROW(Triangulator(c, 0, kAnywhere, LineAlong::rows, AxisStop{0, 1}), std::invalid_argument);
  EXPECT_NO_THROW(Triangulator(c, 0, kAnywhere, LineAlong::rows, AxisStop()));
}

}  // namespace
}  // namespace celadon
