// What a calibration leaves unknown of a matched point, against hand-made changes.

#include "acquisition/stereo/calibration_share.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "tests/acquisition/projection_truth.h"
#include "tests/acquisition/test_calibration.h"

namespace celadon {
namespace {

using Eigen::Vector3d;

MatchedPixels seen(const Calibration& c, const Vector3d& p_O, double first_rad, double second_rad) {
  const auto pixel = [&](double encoder_rad) {
    const double table_rad = c.encoder.direction * c.encoder.scale.value * encoder_rad;
    return ProjectionTruth(c).pixel(c.axis.X_CW *
                                    (Eigen::AngleAxisd(table_rad, Vector3d::UnitZ()) * (p_O / c.scale.value)));
  };
  return {pixel(first_rad), pixel(second_rad), first_rad, second_rad};
}

TEST(StereoCalibrationShare, RaysMeetInThePoint) {
  const Calibration c = test_calibration();
  for (const Vector3d& p : {Vector3d(30, 5, 40), Vector3d(-10, 25, 90), Vector3d(1, 2, 60)}) {
    EXPECT_LT((point_of(seen(c, p, 0.4, 0.54), c) - p).norm(), 1e-6);
  }
}

// The baseline comes from the camera's distance d to the axis: an axis that lies nearer by u makes everything smaller
// by 1 - u / d.
TEST(StereoCalibrationShare, TheAxisDistanceIsTheScale) {
  Calibration c = test_calibration();
  constexpr double kDistance_mm = 300, kU_mm = 0.02;
  c.axis.X_CW = looking_at({kDistance_mm, 0, 60}, {0, 0, 60});
  c.scale = {1, 0};
  c.covariance = CalibrationCovariance{{"axis.x_mm", "laser0.offset_mm"}, Eigen::Matrix2d::Identity()};
  c.covariance->matrix << kU_mm * kU_mm, 0, 0, 1;
  for (const double azimuth : {0., 0.5, 1.}) {
    const Vector3d p(30 * std::cos(azimuth), 30 * std::sin(azimuth), 50);
    EXPECT_NEAR(radius_uncertainty_mm(seen(c, p, -0.07, 0.07), c), kU_mm * 30 / kDistance_mm, 1e-7) << azimuth;
  }
}

TEST(StereoCalibrationShare, WithoutAJointCovarianceItIsWhatTheCalibrationStates) {
  Calibration c = test_calibration();
  c.covariance.reset();
  c.systematic_mm = 0.03;
  c.u_drift_mm = 0.04;
  c.scale = {1, 0.004};
  EXPECT_NEAR(radius_uncertainty_mm(seen(c, {30, 0, 50}, 0, 0.14), c),
              std::sqrt(0.03 * 0.03 + 0.04 * 0.04 + 0.12 * 0.12), 1e-6);
}

}  // namespace
}  // namespace celadon
