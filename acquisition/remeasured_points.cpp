#include "acquisition/remeasured_points.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "acquisition/calibration_change.h"
#include "acquisition/lens.h"

namespace celadon {
namespace {

Eigen::Vector3d turned(const Eigen::Vector3d& p, double angle_rad) {
  const double c = std::cos(angle_rad), s = std::sin(angle_rad);
  return {c * p.x() - s * p.y(), s * p.x() + c * p.y(), p.z()};
}

const LaserPlane& plane_of(const Calibration& calibration, int laser) {
  return *std::find_if(calibration.lasers.begin(), calibration.lasers.end(),
                       [&](const LaserPlane& plane) { return plane.laser == laser; });
}

/// What the sections of the further axes say of their own uncertainty, as numbers of calibration_change.h.
std::vector<std::pair<std::string, double>> axis_deviations(const Calibration& calibration) {
  std::vector<std::pair<std::string, double>> out;
  if (const auto& axis = calibration.elevation) {
    out = {{"elevation.tilt_up_rad", axis->u_direction_rad},
           {"elevation.tilt_across_rad", axis->u_direction_rad},
           {"elevation.up_mm", axis->u_origin_mm},
           {"elevation.across_mm", axis->u_origin_mm},
           {"elevation.scale", axis->scale.u}};
  }
  if (const auto& axis = calibration.lift) {
    out.insert(out.end(), {{"lift.tilt_x_rad", axis->u_direction_rad},
                           {"lift.tilt_y_rad", axis->u_direction_rad},
                           {"lift.scale", axis->scale.u}});
  }
  return out;
}

}  // namespace

Eigen::Matrix3Xd remeasured(const ScannedPoints& points, const Calibration& measured_with, const Calibration& other) {
  const Lens lens(measured_with.camera_model), other_lens(other.camera_model);
  AxisStop stop;
  Eigen::Affine3d X_CW = camera_to_object(measured_with, stop).inverse(), other_X_WC = camera_to_object(other, stop);
  Eigen::Matrix3Xd out(3, points.p_mm.cols());
  for (Eigen::Index i = 0; i < out.cols(); ++i) {
    const auto at = static_cast<std::size_t>(i);
    const double angle = points.table_angle_rad[at];
    if (!points.stop.empty() && points.stop[at] != stop) {
      stop = points.stop[at];
      X_CW = camera_to_object(measured_with, stop).inverse();
      other_X_WC = camera_to_object(other, stop);
    }
    const Eigen::Vector3d p_C = X_CW * turned(points.p_mm.col(i), angle);
    const Eigen::Vector2d pixel = lens.project(p_C.x() / p_C.z(), p_C.y() / p_C.z());
    const UndistortedPoint ray = other_lens.undistort(pixel.x(), pixel.y());
    const Eigen::Vector3d direction(ray.a, ray.b, 1);
    const LaserPlane& plane = plane_of(other, points.laser[at]);
    const Eigen::Vector3d moved_C = direction * (plane.distance_mm / plane.normal_C.dot(direction));
    out.col(i) = turned(other_X_WC * moved_C, -other.encoder.table_rad(measured_with.encoder.encoder_rad(angle)));
  }
  return out;
}

Eigen::MatrixXd calibration_covariance_of(const Quantities& quantities, const ScannedPoints& points,
                                          const Calibration& calibration) {
  const Eigen::Index count = quantities(points.p_mm).size();
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(count, count);
  /// Change of the quantities over one standard deviation of what moves the points.
  const auto change_by = [&](auto&& moved) -> Eigen::VectorXd {
    return 0.5 * (quantities(moved(1.0)) - quantities(moved(-1.0)));
  };
  const auto add_radius = [&](double u_mm) {
    if (!(u_mm > 0)) return;
    const Eigen::VectorXd by = change_by([&](double side) {
      Eigen::Matrix3Xd moved = points.p_mm;
      for (Eigen::Index i = 0; i < moved.cols(); ++i) {
        const double r = moved.col(i).head<2>().norm();
        if (r > 0) moved.col(i).head<2>() *= std::max(0.0, r + side * u_mm) / r;
      }
      return moved;
    });
    out += by * by.transpose();
  };
  add_radius(calibration.u_drift_mm);
  const auto is_joint = [&](const std::string& name) {
    if (!calibration.covariance) return false;
    const auto& names = calibration.covariance->names;
    return std::find(names.begin(), names.end(), name) != names.end();
  };
  for (const auto& [name, deviation] : axis_deviations(calibration)) {
    if (points.stop.empty() || !(deviation > 0) || is_joint(name)) continue;
    const Eigen::VectorXd by = change_by([&, &axis = name, u = deviation](double side) {
      return remeasured(points, calibration, changed(calibration, axis, side * u));
    });
    out += by * by.transpose();
  }
  if (!calibration.covariance) {
    add_radius(calibration.systematic_mm);
    const double relative = calibration.scale.u / calibration.scale.value;
    const Eigen::VectorXd by =
        change_by([&](double side) -> Eigen::Matrix3Xd { return (1 + side * relative) * points.p_mm; });
    return out + by * by.transpose();
  }
  const CalibrationCovariance& covariance = *calibration.covariance;
  const Eigen::Index parameters = covariance.matrix.rows();
  Eigen::MatrixXd by(count, parameters);
  Eigen::VectorXd deviations = covariance.matrix.diagonal().cwiseMax(0).cwiseSqrt();
  for (Eigen::Index j = 0; j < parameters; ++j) {
    if (!(deviations[j] > 0)) {
      by.col(j).setZero();
      continue;
    }
    const std::string& name = covariance.names[static_cast<std::size_t>(j)];
    by.col(j) = change_by([&](double side) {
                  return remeasured(points, calibration, changed(calibration, name, side * deviations[j]));
                }) /
                deviations[j];
  }
  return out + by * covariance.matrix * by.transpose();
}

}  // namespace celadon
