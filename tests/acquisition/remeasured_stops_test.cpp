// What uncertain axes of head and lift do to what was scanned at their stops.

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "acquisition/calibration_change.h"
#include "acquisition/lens.h"
#include "acquisition/remeasured_points.h"
#include "tests/acquisition/stop_truth.h"
#include "tests/acquisition/test_calibration.h"

namespace celadon {
namespace {

using Eigen::Vector3d;

const std::vector<const char*> kAxisNames = {
    "elevation.tilt_up_rad", "elevation.tilt_across_rad", "elevation.up_mm", "elevation.across_mm",
    "elevation.scale",       "lift.tilt_x_rad",           "lift.tilt_y_rad", "lift.scale"};

Calibration with_axes() {
  Calibration c = test_calibration();
  c.elevation = ElevationAxis{{0.5, -0.3, 62}, Vector3d(0.02, -1, 0.01).normalized(), 0, 0, {1.002, 0}};
  c.lift = LiftAxis{Vector3d(0.01, -0.02, 1).normalized(), 0, {0.998, 0}};
  return c;
}

/// Points on the plane of laser 0 as it lies at several stops.
ScannedPoints points_at_stops(const Calibration& c) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> uniform(0, 1);
  ScannedPoints out;
  std::vector<Vector3d> points;
  for (const AxisStop& stop : {AxisStop{0, 0}, AxisStop{0.4, 0}, AxisStop{-0.2, 35}, AxisStop{0.4, 35}}) {
    for (int i = 0; i < 20; ++i) {
      const double angle = 6 * uniform(random);
      const Vector3d about(30 * uniform(random), 30 * uniform(random), 30 + 60 * uniform(random));
      // Along x until the laser's plane is met: the distance from it is linear.
      const auto off = [&](double x) {
        return c.lasers[0].normal_C.dot(seen_at_stop(c, about + Vector3d(x, 0, 0), angle, stop)) -
               c.lasers[0].distance_mm;
      };
      if (std::abs(off(1) - off(0)) < 0.2) continue;
      points.push_back(about + Vector3d(off(0) / (off(0) - off(1)), 0, 0));
      out.table_angle_rad.push_back(angle);
      out.laser.push_back(0);
      out.stop.push_back(stop);
    }
  }
  out.p_mm.resize(3, static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i) out.p_mm.col(static_cast<Eigen::Index>(i)) = points[i];
  return out;
}

TEST(RemeasuredAtStops, PixelsStayAndPlanesHold) {
  const Calibration c = with_axes();
  const ScannedPoints points = points_at_stops(c);
  ASSERT_GT(points.p_mm.cols(), 50);
  EXPECT_LT((remeasured(points, c, c) - points.p_mm).cwiseAbs().maxCoeff(), 1e-9);
  std::vector<const char*> names = kAxisNames;
  for (const char* name : {"axis.tilt_x_rad", "axis.x_mm", "platter.height_mm", "laser0.offset_mm"})
    names.push_back(name);
  const Lens lens(c.camera_model);
  for (const char* name : names) {
    ASSERT_TRUE(has_parameter(c, name)) << name;
    const Calibration other = changed(c, name, 1e-3);
    const Eigen::Matrix3Xd moved = remeasured(points, c, other);
    double largest = 0, unmoved = 0;
    for (Eigen::Index i = 0; i < moved.cols(); ++i) {
      const auto k = static_cast<std::size_t>(i);
      const Vector3d p = seen_at_stop(c, points.p_mm.col(i), points.table_angle_rad[k], points.stop[k]),
                     q = seen_at_stop(other, moved.col(i), points.table_angle_rad[k], points.stop[k]);
      EXPECT_NEAR((lens.project(q.x() / q.z(), q.y() / q.z()) - lens.project(p.x() / p.z(), p.y() / p.z())).norm(), 0,
                  1e-7)
          << name;
      EXPECT_NEAR(other.lasers[0].normal_C.dot(q), other.lasers[0].distance_mm, 1e-9) << name;
      const double by = (moved.col(i) - points.p_mm.col(i)).norm();
      largest = std::max(largest, by);
      if (points.stop[k] == AxisStop()) unmoved = std::max(unmoved, by);
    }
    EXPECT_GT(largest, 1e-6) << name;
    // At 0 nobody needs to know the axes.
    const bool of_axes = std::string(name).starts_with("elevation") || std::string(name).starts_with("lift");
    EXPECT_EQ(unmoved < 1e-9, of_axes) << name;
  }
  const Calibration without = test_calibration();
  for (const char* name : kAxisNames) EXPECT_FALSE(has_parameter(without, name)) << name;
}

TEST(CalibrationChange, MovesTheAxesAsItsNamesSay) {
  Calibration c = with_axes();
  c.elevation->direction = {0, -1, 0};  // u = z, v = d x u = -x
  constexpr double kStep = 1e-3;
  const auto elevation = [&](const char* name) { return *changed(c, name, kStep).elevation; };
  EXPECT_LT((elevation("elevation.tilt_up_rad").direction - Vector3d(0, -1, kStep)).norm(), 1e-6);
  EXPECT_LT((elevation("elevation.tilt_across_rad").direction - Vector3d(-kStep, -1, 0)).norm(), 1e-6);
  EXPECT_NEAR(elevation("elevation.tilt_up_rad").direction.norm(), 1, 1e-15);
  EXPECT_LT((elevation("elevation.up_mm").origin_mm - c.elevation->origin_mm - Vector3d(0, 0, kStep)).norm(), 1e-12);
  EXPECT_LT((elevation("elevation.across_mm").origin_mm - c.elevation->origin_mm - Vector3d(-kStep, 0, 0)).norm(),
            1e-12);
  EXPECT_NEAR(elevation("elevation.scale").scale.value, 1.003, 1e-12);
  c.lift->direction = {0, 0, 1};
  const auto lift = [&](const char* name) { return *changed(c, name, kStep).lift; };
  EXPECT_LT((lift("lift.tilt_x_rad").direction - Vector3d(kStep, 0, 1)).norm(), 1e-6);
  EXPECT_LT((lift("lift.tilt_y_rad").direction - Vector3d(0, kStep, 1)).norm(), 1e-6);
  EXPECT_NEAR(lift("lift.scale").scale.value, 0.999, 1e-12);
}

// A length along z from one height of the lift to another is as uncertain as the lift's way.
TEST(CalibrationCovariance, ALengthOverTwoHeightsHasTheLiftsUncertainty) {
  Calibration c = with_axes();
  c.lift->direction = {0, 0, 1};
  c.covariance = CalibrationCovariance{{"lift.scale"}, Eigen::MatrixXd::Constant(1, 1, 1e-3 * 1e-3)};
  ScannedPoints points;
  points.p_mm.resize(3, 2);
  points.p_mm << 20, 20, 5, 5, 30, 110;
  points.table_angle_rad = {0.5, 0.5};
  points.laser = {0, 0};
  points.stop = {{0, 0}, {0, 80}};
  // Each on the laser's plane as it is seen there.
  for (Eigen::Index i = 0; i < 2; ++i) {
    const auto off = [&](double x) {
      const Vector3d p = points.p_mm.col(i) + Vector3d(x, 0, 0);
      return c.lasers[0].normal_C.dot(seen_at_stop(c, p, 0.5, points.stop[static_cast<std::size_t>(i)])) -
             c.lasers[0].distance_mm;
    };
    points.p_mm(0, i) += off(0) / (off(0) - off(1));
  }
  const Eigen::MatrixXd C = calibration_covariance_of(
      [](const Eigen::Matrix3Xd& p) { return Eigen::VectorXd::Constant(1, p(2, 1) - p(2, 0)).eval(); }, points, c);
  EXPECT_NEAR(std::sqrt(C(0, 0)), 80e-3, 1e-9);
  // The section's own statement does as well where nothing is joint, and not twice where it is.
  c.lift->scale.u = 1e-3;
  const auto length = [](const Eigen::Matrix3Xd& p) { return Eigen::VectorXd::Constant(1, p(2, 1) - p(2, 0)).eval(); };
  EXPECT_NEAR(std::sqrt(calibration_covariance_of(length, points, c)(0, 0)), 80e-3, 1e-9);
  c.covariance.reset();
  c.scale.u = c.systematic_mm = 0;
  EXPECT_NEAR(std::sqrt(calibration_covariance_of(length, points, c)(0, 0)), 80e-3, 1e-9);
}

}  // namespace
}  // namespace celadon
