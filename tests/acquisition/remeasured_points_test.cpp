#include "acquisition/remeasured_points.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <random>

#include "acquisition/calibration_change.h"
#include "acquisition/lens.h"
#include "tests/acquisition/test_calibration.h"

namespace celadon {
namespace {

using Eigen::Vector3d;

const char* const kNames[] = {"fx_px",
                              "fy_px",
                              "cx_px",
                              "cy_px",
                              "k1",
                              "k2",
                              "p1",
                              "p2",
                              "k3",
                              "axis.tilt_x_rad",
                              "axis.tilt_y_rad",
                              "axis.x_mm",
                              "axis.y_mm",
                              "platter.height_mm",
                              "encoder.scale",
                              "encoder.cos_rad",
                              "encoder.sin_rad",
                              "laser0.tilt_up_rad",
                              "laser0.tilt_across_rad",
                              "laser0.offset_mm",
                              "laser1.offset_mm"};

Vector3d turned(const Vector3d& p, double angle) {
  return Eigen::AngleAxisd(angle, Vector3d::UnitZ()) * p;
}

/// Points on both laser planes, lit at many table angles.
ScannedPoints points_of(const Calibration& calibration) {
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::vector<Vector3d> points;
  ScannedPoints out;
  const Eigen::Isometry3d X_WC = calibration.axis.X_CW.inverse();
  for (const LaserPlane& plane : calibration.lasers) {
    const Vector3d n = X_WC.linear() * plane.normal_C;
    const double distance = plane.distance_mm + plane.normal_C.dot(-calibration.axis.X_CW.translation());
    const Vector3d outward = Vector3d(n.y(), -n.x(), 0).normalized();
    for (int i = 0; i < 40; ++i) {
      Vector3d p = (20 + 20 * uniform(random)) * outward + Vector3d(0, 0, 20 + 80 * uniform(random));
      p += n * (distance - n.dot(p));
      const double angle = 6 * uniform(random);
      points.push_back(turned(calibration.scale.value * p, -angle));
      out.table_angle_rad.push_back(angle);
      out.laser.push_back(plane.laser);
    }
  }
  out.p_mm.resize(3, static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i) out.p_mm.col(static_cast<Eigen::Index>(i)) = points[i];
  return out;
}

/// Camera frame, from an object point at a table angle.
Vector3d seen(const Calibration& c, const Eigen::Matrix3Xd& p, Eigen::Index i, double table_rad) {
  return c.axis.X_CW * (turned(p.col(i), table_rad) / c.scale.value);
}

/// The table's angle by one calibration where another one says `table_rad`, from CALIBRATION.md's formula; the encoder
/// by halving.
double by_other(const Calibration& c, const Calibration& other, double table_rad) {
  const auto at = [](const TableEncoder& e, double b) {
    return e.direction * (e.scale.value * b + e.cos_rad.value * (std::cos(b) - 1) + e.sin_rad.value * std::sin(b));
  };
  double low = -20, high = 20;
  for (int k = 0; k < 100; ++k) {
    const double middle = 0.5 * (low + high);
    ((at(c.encoder, middle) < table_rad) == (c.encoder.direction > 0) ? low : high) = middle;
  }
  return at(other.encoder, low);
}

TEST(RemeasuredPoints, TheSameCalibrationMovesNothing) {
  const Calibration c = test_calibration();
  const ScannedPoints points = points_of(c);
  EXPECT_LT((remeasured(points, c, c) - points.p_mm).cwiseAbs().maxCoeff(), 1e-9);
}

// The pixel stays, the point lies on the other plane.
TEST(RemeasuredPoints, PixelsStayAndPlanesHold) {
  Calibration c = test_calibration();
  c.encoder.cos_rad.value = 2e-3;
  c.encoder.sin_rad.value = -3e-3;
  const ScannedPoints points = points_of(c);
  for (const char* name : kNames) {
    ASSERT_TRUE(has_parameter(c, name)) << name;
    const Calibration other = changed(c, name, 1e-4);
    const Eigen::Matrix3Xd moved = remeasured(points, c, other);
    const Lens before(c.camera_model), after(other.camera_model);
    double largest = 0;
    for (Eigen::Index i = 0; i < moved.cols(); ++i) {
      const double angle = points.table_angle_rad[static_cast<std::size_t>(i)];
      const Vector3d p = seen(c, points.p_mm, i, angle), q = seen(other, moved, i, by_other(c, other, angle));
      EXPECT_NEAR((after.project(q.x() / q.z(), q.y() / q.z()) - before.project(p.x() / p.z(), p.y() / p.z())).norm(),
                  0, 1e-7)
          << name;
      const LaserPlane& plane = other.lasers[static_cast<std::size_t>(points.laser[static_cast<std::size_t>(i)])];
      EXPECT_NEAR(plane.normal_C.dot(q), plane.distance_mm, 1e-9) << name;
      largest = std::max(largest, (moved.col(i) - points.p_mm.col(i)).norm());
    }
    EXPECT_GT(largest, 1e-9) << name;
  }
  EXPECT_FALSE(has_parameter(c, "laser9.offset_mm"));
  EXPECT_FALSE(has_parameter(c, "laser1.offset"));
  EXPECT_FALSE(has_parameter(c, "pitch_x"));
  EXPECT_FALSE(has_parameter(c, ""));
}

// What CALIBRATION.md says the names mean.
TEST(CalibrationChange, MovesWhatTheNameSays) {
  const Calibration c = test_calibration();
  const Eigen::Isometry3d X = c.axis.X_CW;
  constexpr double kStep = 1e-3;
  const auto frame = [&](const char* name) { return X.inverse() * changed(c, name, kStep).axis.X_CW; };
  EXPECT_LT((frame("axis.tilt_x_rad").linear().col(2) - Vector3d(kStep, 0, 1)).norm(), 2e-6);
  EXPECT_LT((frame("axis.tilt_y_rad").linear().col(2) - Vector3d(0, kStep, 1)).norm(), 2e-6);
  EXPECT_LT(frame("axis.tilt_y_rad").translation().norm(), 1e-12);
  EXPECT_LT((frame("axis.x_mm").translation() - Vector3d(kStep, 0, 0)).norm(), 1e-12);
  EXPECT_LT((frame("axis.y_mm").translation() - Vector3d(0, kStep, 0)).norm(), 1e-12);
  EXPECT_LT((frame("platter.height_mm").translation() - Vector3d(0, 0, kStep)).norm(), 1e-12);

  const LaserPlane& plane = c.lasers[1];
  const Vector3d n = plane.normal_C, up = X.linear().col(2), origin = X.translation();
  const Vector3d u = (up - n * n.dot(up)).normalized(), foot = origin + n * (plane.distance_mm - n.dot(origin));
  const auto moved = [&](const char* name) { return changed(c, name, kStep).lasers[1]; };
  EXPECT_LT((moved("laser1.tilt_up_rad").normal_C - n - kStep * u).norm(), 2e-6);
  EXPECT_LT((moved("laser1.tilt_across_rad").normal_C - n - kStep * n.cross(u)).norm(), 2e-6);
  for (const char* name : {"laser1.tilt_up_rad", "laser1.tilt_across_rad"}) {
    EXPECT_NEAR(moved(name).normal_C.dot(foot), moved(name).distance_mm, 1e-9) << name;
  }
  EXPECT_NEAR(moved("laser1.offset_mm").distance_mm - plane.distance_mm, kStep, 1e-12);
  EXPECT_EQ(changed(c, "laser1.offset_mm", kStep).lasers[0].distance_mm, c.lasers[0].distance_mm);
}

/// Mean radius and mean height.
Eigen::VectorXd means_of(const Eigen::Matrix3Xd& p) {
  return Eigen::Vector2d(p.topRows<2>().colwise().norm().mean(), p.row(2).mean());
}

TEST(CalibrationCovariance, WithoutOneScaleAndRadiusAreUncertain) {
  Calibration c = test_calibration();
  const ScannedPoints points = points_of(c);
  const Eigen::Vector2d mean = means_of(points.p_mm);
  c.scale = {1.001, 0.003};
  c.systematic_mm = 0.02;
  c.u_drift_mm = 0.05;
  const Eigen::MatrixXd C = calibration_covariance_of(means_of, points, c);
  const double relative = 0.003 / 1.001;
  EXPECT_NEAR(C(0, 0), std::pow(mean.x() * relative, 2) + 0.02 * 0.02 + 0.05 * 0.05, 1e-9);
  EXPECT_NEAR(C(1, 1), std::pow(mean.y() * relative, 2), 1e-9);
  EXPECT_NEAR(C(0, 1), mean.x() * mean.y() * relative * relative, 1e-9);
}

// Against calibrations drawn from the covariance.
TEST(CalibrationCovariance, IsTheSpreadOfDrawnCalibrations) {
  Calibration c = test_calibration();
  const ScannedPoints points = points_of(c);
  const std::vector<double> sizes = {0.3,  0.3,  0.4,  0.4,  1e-4, 1e-3, 1e-5, 1e-5, 1e-3, 1e-4,
                                     1e-4, 0.02, 0.02, 0.03, 1e-5, 1e-4, 1e-4, 0.01, 0.01};
  const auto count = static_cast<Eigen::Index>(sizes.size());
  std::mt19937_64 random(11);
  std::normal_distribution<double> normal;
  // Correlated: half of each is common to all.
  Eigen::MatrixXd correlation = Eigen::MatrixXd::Constant(count, count, 0.5);
  correlation.diagonal().setOnes();
  const Eigen::VectorXd sigma = Eigen::Map<const Eigen::VectorXd>(sizes.data(), count);
  c.covariance = CalibrationCovariance{{std::begin(kNames), std::end(kNames)},
                                       sigma.asDiagonal() * correlation * sigma.asDiagonal()};
  const Eigen::MatrixXd stated = calibration_covariance_of(means_of, points, c);
  const Eigen::MatrixXd root = sigma.asDiagonal() * Eigen::MatrixXd(correlation.llt().matrixL());
  constexpr int kDraws = 3000;
  Eigen::MatrixXd drawn(2, kDraws);
  for (int k = 0; k < kDraws; ++k) {
    const Eigen::VectorXd x = root * Eigen::VectorXd::NullaryExpr(count, [&] { return normal(random); });
    Calibration moved = c;
    for (Eigen::Index i = 0; i < count; ++i) moved = changed(moved, kNames[i], x[i]);
    drawn.col(k) = means_of(remeasured(points, c, moved)) - means_of(points.p_mm);
  }
  const Eigen::MatrixXd observed = drawn * drawn.transpose() / kDraws;
  // A standard deviation of 3000 draws is known to 1.3 %.
  EXPECT_NEAR(std::sqrt(observed(0, 0) / stated(0, 0)), 1, 0.05);
  EXPECT_NEAR(std::sqrt(observed(1, 1) / stated(1, 1)), 1, 0.05);
  EXPECT_NEAR(observed(0, 1) / std::sqrt(stated(0, 0) * stated(1, 1)),
              stated(0, 1) / std::sqrt(stated(0, 0) * stated(1, 1)), 0.06);
}

}  // namespace
}  // namespace celadon
