#pragma once
// A machine as it could stand on a desk: camera 350 mm from the axis, two laser planes that nearly hold the axis.

#include <cmath>

#include "acquisition/calibration.h"

namespace celadon {

/// Pose of a camera at `eye`, looking at `target`, rows horizontal.
inline Eigen::Isometry3d looking_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target) {
  const Eigen::Vector3d forward = (target - eye).normalized();
  const Eigen::Vector3d right = forward.cross(Eigen::Vector3d::UnitZ()).normalized();
  Eigen::Isometry3d X_CW = Eigen::Isometry3d::Identity();
  X_CW.linear().row(0) = right.transpose();
  X_CW.linear().row(1) = forward.cross(right).transpose();
  X_CW.linear().row(2) = forward.transpose();
  X_CW.translation() = -X_CW.linear() * eye;
  return X_CW;
}

/// The vertical plane through the axis at an azimuth, moved by `offset_mm` and tilted.
inline LaserPlane laser_plane(int number, const Eigen::Isometry3d& X_CW, double azimuth_rad, double offset_mm,
                              double tilt_rad) {
  const Eigen::Vector3d normal_W(-std::sin(azimuth_rad) * std::cos(tilt_rad),
                                 std::cos(azimuth_rad) * std::cos(tilt_rad), std::sin(tilt_rad));
  LaserPlane plane;
  plane.laser = number;
  plane.normal_C = X_CW.linear() * normal_W;
  plane.distance_mm = offset_mm + plane.normal_C.dot(X_CW.translation());
  plane.u_normal_rad = 2e-4;
  plane.u_distance_mm = 0.02;
  return plane;
}

inline Calibration test_calibration() {
  Calibration out;
  out.machine = "Celadon test bench 42";
  out.camera = "Test camera 0815";
  out.date = "2025-03-31T14:05:00Z";
  out.camera_model = {.width_px = 1280,
                      .height_px = 1024,
                      .fx_px = {1402.25, 0.5},
                      .fy_px = {1400.75, 0.5},
                      .cx_px = {650.5, 0.8},
                      .cy_px = {500.25, 0.8},
                      .distortion = {{{-0.21, 0.002}, {0.13, 0.01}, {8e-4, 1e-4}, {-5e-4, 1e-4}, {-0.02, 0.01}}}};
  out.axis.X_CW = looking_at({320, 90, 180}, {2, -3, 70});
  out.axis.u_direction_rad = 1e-4;
  out.axis.u_position_mm = 0.02;
  out.lasers = {laser_plane(0, out.axis.X_CW, -0.35, 0.1, 0.004), laser_plane(1, out.axis.X_CW, 0.9, -0.2, -0.002)};
  out.encoder.scale = {1.0002, 1e-5};
  out.encoder.direction = -1;
  out.scale = {1.001, 5e-4};
  out.systematic_mm = 0.015;
  out.time = {{-1.5e6, 2e5}, {-0.5, 0.01}, {25'000, 10}};
  return out;
}

}  // namespace celadon
