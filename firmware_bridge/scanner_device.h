#pragma once
// The scanner as its owner sees it: motion, laser lease, button, lamp, one way to make it safe. The controller enforces
// what matters (PROTOCOL.md); illegal calls for the state are refused here before they reach it.

#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "firmware_bridge/clock.h"
#include "firmware_bridge/device_error.h"
#include "firmware_bridge/protocol.h"
#include "firmware_bridge/transport.h"

namespace celadon {

struct DeviceIdentity {
  std::string machine;  ///< "VENDOR MODEL SERIAL"; calibration files quote it
  std::uint16_t protocol_major = 0, protocol_minor = 0, firmware_version = 0;
  bool simulated = false;
};

/// What an axis moves. Its positions are radians; a lift's are millimetres.
enum class AxisKind : std::uint16_t {
  turntable = protocol::kTurntable,  ///< the object, about +z
  elevation = protocol::kElevation,  ///< camera and lasers together, upwards
  lift = protocol::kLift             ///< the table and what stands on it, upwards
};

/// "table", "elevation", "lift".
const char* axis_name(AxisKind kind);

/// What an axis can do: rad, rad/s, rad/s^2; a lift: mm, mm/s, mm/s^2.
struct AxisLimits {
  double lowest = -std::numeric_limits<double>::infinity();  ///< of its travel
  double highest = std::numeric_limits<double>::infinity();
  double max_speed = 0, max_acceleration = 0;
  double resolution = 0;  ///< smallest step of the position
};

struct DeviceCapabilities {
  int axes = 1, lasers = 1;
  bool endless_rotation = true;
  double travel_rad = 0;         ///< 0 if endless
  double travel_min_rad = 0;     ///< lowest angle, where not endless
  bool takes_jerk = false;       ///< moves may be S-curves
  bool stamped_by_host = false;  ///< position_time_us is when the sample was read, not when it was taken
  double encoder_resolution_rad = 0, max_speed_rad_per_s = 0, max_acceleration_rad_per_s2 = 0;
  int laser_class = 2;          ///< 1, 2, 3 (3R), 4 (3B) as printed in PROTOCOL.md; read-only identity
  std::int64_t lease_ms = 500;  ///< longest laser lease the controller grants
  bool host_watchdog = true;
  std::int64_t heartbeat_timeout_ms = 1000;   ///< silence after which the controller stops motor and lasers
  std::int64_t session_timeout_ms = 0;        ///< 0: the controller has no sessions
  bool remote_enable_switch = false;          ///< a switch at the machine allows or forbids a start from afar
  std::optional<AxisLimits> elevation, lift;  ///< where the machine has them
};

/// An axis besides the table at the newest poll; radians, of a lift millimetres.
struct AxisStatus {
  MotionState motion = MotionState::unhomed;
  bool homed = false;
  double position = 0, target = 0, speed = 0;
  std::uint32_t position_counter = 0;
  std::uint64_t position_time_us = 0;  ///< controller's clock, of the position sample
};

/// Everything one poll (one block read) brings. Motion, angle and position are the table's.
struct DeviceStatus {
  MotionState motion = MotionState::unhomed;
  double angle_rad = 0;  ///< actual, unwrapped
  double target_rad = 0;
  double speed_rad_per_s = 0;
  std::uint32_t position_counter = 0;
  std::uint64_t position_time_us = 0;  ///< controller's clock, of the position sample
  bool interlock_closed = false, emergency_stop = false;
  std::uint16_t lasers_on = 0;  ///< bit per laser, as measured by the controller
  std::uint32_t lease_left_ms = 0;
  bool button_down = false;
  std::uint16_t button_presses = 0;  ///< latched counter, wraps
  std::uint16_t button_held_ms = 0;  ///< how long it is down, or was the last time; stays at 65535
  std::uint16_t fault_code = 0;
  std::string fault_text;  ///< meaning of fault_code and, where known, of the drive's own number; empty for none
  bool homed = false;
  bool remote_enabled = false;          ///< by the switch at the machine, where there is one
  bool local_action_needed = false;     ///< commands are refused until the button on the machine is pressed
  LampPattern lamp = LampPattern::off;  ///< as shown
  std::uint16_t boot_id = 0;            ///< changes with every start of the controller
  std::uint64_t uptime_us = 0;          ///< controller's clock when it replied
  std::int64_t host_before_ns = 0, host_after_ns = 0;  ///< around the exchange
  std::optional<AxisStatus> elevation, lift;           ///< where the machine has them
};

/// How moves go from now on: where to, and how gently.
struct MotionLimits {
  double lowest_rad = -std::numeric_limits<double>::infinity();  ///< soft limits: no target beyond them
  double highest_rad = std::numeric_limits<double>::infinity();
  double jerk_rad_per_s3 = 0;  ///< of S-curves; 0: trapezoids
};

/// How well the link to the controller works, since it was opened.
struct LinkQuality {
  std::uint64_t requests = 0;  ///< sent, repeats too
  std::uint64_t retries = 0, time_outs = 0, broken_replies = 0, exceptions = 0, reconnects = 0;
  std::int64_t round_trip_ns = 0, longest_round_trip_ns = 0;  ///< of polls
};

/// What make_safe found and left.
struct SafeReport {
  std::uint16_t lasers_were_on = 0;
  MotionState motion_was = MotionState::unhomed;   ///< of the table, or of another axis that moved
  bool lasers_off = false, motor_stopped = false;  ///< motor: of every axis
  std::string text;                                ///< one sentence
};

class ScannerDevice {
 public:
  /// Connects, checks identity and protocol version, makes safe first, then takes the machine for this host (section 9
  /// of PROTOCOL.md) and keeps it by polling; refused while another host holds it.
  static tl::expected<std::unique_ptr<ScannerDevice>, DeviceError> open(std::unique_ptr<Transport> transport,
                                                                        Clock& clock);
  ~ScannerDevice();  ///< makes safe

  const DeviceIdentity& identity() const;
  const DeviceCapabilities& capabilities() const;
  const SafeReport& found_at_open() const;
  const LinkQuality& link_quality() const;

  /// One block read; also the heartbeat. Retries are bounded; a lost link is reported as such, and so is, once, a
  /// controller that restarted since the last poll (it is unhomed then, and dark), or whose clock or position jumped.
  /// After a jump of the position `homed` is false until the next home().
  tl::expected<DeviceStatus, DeviceError> poll();
  /// Presses seen by polls since the last call: none is lost between polls or across reconnects. Presses from before
  /// open() do not count, those after a restart of the controller do.
  std::uint16_t take_button_presses();

  /// Whether the controller tells of changes (button, fault, motion) by itself.
  bool tells_changes() const;
  /// Whether it told of one since the last call, or is gone; poll() says what it was. Never waits.
  bool changed();
  /// Position samples that the controller sent by itself since the last call, oldest first; none where it does not.
  std::size_t take_trace(std::span<TraceSample> samples);

  /// Refused where lowest_rad is not below highest_rad, or for a jerk that the controller does not take.
  tl::expected<void, DeviceError> set_motion_limits(const MotionLimits& limits);
  /// The way that the axis needs from rest to a speed, or from it to rest: v^2 / 2a, with a jerk j va / 2j more where
  /// vj >= a^2, else v sqrt(v / j).
  double run_up_rad(double speed_rad_per_s) const;

  /// Asked at every poll while home() and rotate_to() wait. Where it gives a reason, they stop the motor, turn the
  /// lasers off and return Kind::interrupted with it as the cause.
  void set_interrupt(std::function<std::optional<std::string>()> interrupted);

  /// Finds the index; returns at standstill. Polls while waiting.
  tl::expected<void, DeviceError> home();
  /// Absolute move by the short or given way (angles unwrapped); returns settled. Refused unless homed and standing.
  tl::expected<DeviceStatus, DeviceError> rotate_to(double angle_rad, double speed_rad_per_s);
  /// Starts a constant-speed move to angle_rad and returns once it moves; poll() follows it.
  tl::expected<void, DeviceError> start_sweep(double angle_rad, double speed_rad_per_s);
  bool has_axis(AxisKind kind) const;
  /// Of the table within the soft limits. @pre has_axis(kind)
  AxisLimits limits(AxisKind kind) const;
  /// Finds the axis's reference; returns at standstill. Each axis is homed by itself; refused where there is none.
  tl::expected<void, DeviceError> home_axis(AxisKind kind);
  /// Absolute move at the axis's greatest speed; returns settled. Refused beyond its travel, and unless it is homed and
  /// stands; the other axes may move. Radians, of a lift millimetres.
  tl::expected<void, DeviceError> move_axis(AxisKind kind, double position);
  /// Releases a machine that was stopped or had a fault; it starts nothing. After a fault home() must follow.
  tl::expected<void, DeviceError> clear_fault();
  /// Stops every axis with its deceleration; returns at standstill.
  tl::expected<void, DeviceError> stop();

  /// Grants or renews a lease on a laser for at most capabilities().lease_ms; call it only from the loop that accepts
  /// frames. However often it has to be repeated on a bad link, the lease ends no later than lease_ms after the call.
  /// Refused with an open interlock, in a fault state or for class above what the controller declares safe.
  tl::expected<void, DeviceError> renew_laser(int laser, std::int64_t lease_ms);
  tl::expected<void, DeviceError> laser_off();
  tl::expected<void, DeviceError> set_lamp(LampPattern pattern);

  /// Lasers off, all axes stopped, verified by reading back; tried even on a broken link. Never throws.
  SafeReport make_safe() noexcept;

 private:
  struct Impl;
  explicit ScannerDevice(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace celadon
