#include "daemon/calibration/unmeasured.h"

#include <cmath>

namespace celadon {

Calibration nothing_known(const ScannerConnection& machine) {
  const CameraMode& mode = machine.camera->mode();
  Calibration c;
  c.machine = machine.device->identity().machine;
  c.camera = mode.identity;
  c.camera_model.width_px = mode.width_px;
  c.camera_model.height_px = mode.height_px;
  c.camera_model.fx_px.value = c.camera_model.fy_px.value = mode.width_px;
  c.camera_model.cx_px.value = 0.5 * (mode.width_px - 1);
  c.camera_model.cy_px.value = 0.5 * (mode.height_px - 1);
  for (int laser = 0; laser < machine.device->capabilities().lasers; ++laser) {
    c.lasers.push_back({.laser = laser, .normal_C = Eigen::Vector3d::UnitX(), .distance_mm = 1});
  }
  c.time.stamp_offset_ns.value = -2. * static_cast<double>(mode.frame_period_ns);
  c.time.exposure_factor.value = -0.5;
  return c;
}

TimeModel assumed_time(const CameraMode& mode) {
  TimeModel time;
  const auto period_ns = static_cast<double>(mode.frame_period_ns);
  const bool at_start = mode.stamp_point == StampPoint::start_of_exposure;
  time.stamp_offset_ns = {0, period_ns / 2 / std::sqrt(3.)};
  time.exposure_factor = {at_start ? 0.5 : -0.5, 0};
  time.line_time_ns = {0, mode.shutter == Shutter::rolling ? period_ns / mode.height_px / std::sqrt(3.) : 0};
  return time;
}

}  // namespace celadon
