#include "acquisition/stereo/calibration_share.h"

#include <Eigen/Geometry>
#include <cmath>
#include <string>

#include "acquisition/calibration_change.h"
#include "acquisition/lens.h"

namespace celadon {
namespace {

struct TableRay {
  Eigen::Vector3d from, along;
};

TableRay ray_of(const Eigen::Vector2d& pixel, double encoder_rad, const Calibration& calibration) {
  const UndistortedPoint ray = Lens(calibration.camera_model).undistort(pixel.x(), pixel.y());
  const double table_rad = calibration.encoder.table_rad(encoder_rad);
  const Eigen::Affine3d X_OC =
      Eigen::AngleAxisd(-table_rad, Eigen::Vector3d::UnitZ()) * camera_to_object(calibration, {});
  return {X_OC.translation(), (X_OC.linear() * Eigen::Vector3d(ray.a, ray.b, 1)).normalized()};
}

double radius_of(const MatchedPixels& match, const Calibration& calibration) {
  return point_of(match, calibration).head<2>().norm();
}

}  // namespace

Eigen::Vector3d point_of(const MatchedPixels& match, const Calibration& calibration) {
  const TableRay a = ray_of(match.first_px, match.first_rad, calibration),
                 b = ray_of(match.second_px, match.second_rad, calibration);
  const Eigen::Vector3d between = b.from - a.from;
  const double c = a.along.dot(b.along), sine2 = 1 - c * c;
  const double s = (between.dot(a.along) - c * between.dot(b.along)) / sine2,
               t = (c * between.dot(a.along) - between.dot(b.along)) / sine2;
  return 0.5 * (a.from + s * a.along + b.from + t * b.along);
}

double radius_uncertainty_mm(const MatchedPixels& match, const Calibration& calibration) {
  double variance = calibration.u_drift_mm * calibration.u_drift_mm;
  if (!calibration.covariance) {
    const double of_scale = calibration.scale.u / calibration.scale.value * radius_of(match, calibration);
    return std::sqrt(variance + calibration.systematic_mm * calibration.systematic_mm + of_scale * of_scale);
  }
  const CalibrationCovariance& covariance = *calibration.covariance;
  const Eigen::Index n = covariance.matrix.rows();
  Eigen::VectorXd by = Eigen::VectorXd::Zero(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const std::string& name = covariance.names[static_cast<std::size_t>(i)];
    const double deviation = std::sqrt(std::max(0., covariance.matrix(i, i)));
    if (!(deviation > 0) || name.starts_with("laser")) continue;
    by[i] = (radius_of(match, changed(calibration, name, deviation)) -
             radius_of(match, changed(calibration, name, -deviation))) /
            (2 * deviation);
  }
  return std::sqrt(variance + by.dot(covariance.matrix * by));
}

}  // namespace celadon
