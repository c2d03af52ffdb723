#pragma once
// Motion of the machine's axes: what is checked before a command, how long it may take, how it ends.

#include <cstdint>
#include <functional>
#include <initializer_list>
#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "firmware_bridge/device_poll.h"

namespace celadon {

class DeviceMotion {
 public:
  explicit DeviceMotion(DevicePoll& machine) : machine_(machine) {}

  std::function<std::optional<std::string>()> interrupted;  ///< the owner's wish to end a motion early
  MotionLimits limits;                                      ///< of the table

  bool has(AxisKind kind) const;
  /// @pre has(kind)
  AxisLimits limits_of(AxisKind kind) const;
  double run_up_rad(double speed_rad_per_s) const;
  tl::expected<void, DeviceError> set_limits(const MotionLimits& wanted);

  tl::expected<void, DeviceError> home(const std::string& operation, AxisKind kind);
  tl::expected<void, DeviceError> rotate_to(const std::string& operation, double angle_rad, double speed_rad_per_s);
  tl::expected<void, DeviceError> start_sweep(const std::string& operation, double angle_rad, double speed_rad_per_s);
  /// @pre kind is not the table
  tl::expected<void, DeviceError> move_axis(const std::string& operation, AxisKind kind, double position);
  /// Stops all axes; returns when they stand.
  tl::expected<void, DeviceError> stop(const std::string& operation);
  SafeReport make_safe();

 private:
  tl::expected<void, DeviceError> require(const std::string& operation, AxisKind kind,
                                          std::initializer_list<MotionState> allowed);
  tl::expected<void, DeviceError> command(const std::string& operation, AxisKind kind, const AxisOrder& order);
  tl::expected<void, DeviceError> send_rotation(const std::string& operation, double angle_rad, double speed_rad_per_s);
  tl::expected<void, DeviceError> finish_move(const std::string& operation, AxisKind kind, double target, double speed);
  tl::expected<void, DeviceError> finish_motion(const std::string& operation, AxisKind kind, std::int64_t limit_ns);
  tl::expected<void, DeviceError> require_standstill(const std::string& operation, AxisKind kind) const;
  AxisStatus now(AxisKind kind) const { return axis_status(machine_.last->status, kind); }
  double rounding_s() const;
  double stopping_s(AxisKind kind) const;
  double longest_stopping_s() const;

  DevicePoll& machine_;
};

}  // namespace celadon
