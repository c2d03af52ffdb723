#pragma once
// The controller's side of the protocol, for firmware and for the virtual scanner: registers, leases, watchdog, states,
// button and lamp. It owns every decision that matters for safety; motor, encoder, lasers and inputs are the plant's.
// Freestanding: no heap, no operating system, no exceptions, no floating point, no threads.

#include <cstdint>

#include "firmware_bridge/protocol.h"

namespace celadon {

enum class AxisPhase : std::uint8_t { standing, moving, settling };

/// One position sample of an axis and what its motor does; of a lift micrometres instead of microdegrees.
struct AxisSample {
  std::uint64_t time_us = 0;       ///< controller's clock, of the sample
  std::uint32_t counter = 0;       ///< of position samples
  std::int64_t position_udeg = 0;  ///< unwrapped; 0 at the index once homed
  std::int32_t speed_udeg_per_s = 0;
  AxisPhase phase = AxisPhase::standing;
  bool index_found = false;  ///< the last home() ended at the index
  FaultCode fault = FaultCode::none;
  std::uint16_t fault_detail = 0;  ///< the drive's own number
};

/// What the plant senses besides its axes. The raw button: the core debounces it.
struct PlantInputs {
  bool interlock_closed = false;
  bool emergency_stop = false;
  bool button = false;
  bool remote_enabled = true;         ///< the switch at the machine that allows a start from afar, where there is one
  std::uint16_t lasers_measured = 0;  ///< bit per laser that emits, by photodiode or drive current
  FaultCode fault = FaultCode::none;  ///< of lasers or controller
  std::uint16_t fault_detail = 0;
};

/// Motor, encoder, lasers, lamp and inputs. The core calls it from step() and from the register handlers, in the
/// caller's thread. From the return of home() and move() until the motion has ended and settled, phase is not standing.
class Plant {
 public:
  virtual PlantInputs inputs(std::uint64_t now_us) = 0;
  virtual AxisSample axis(int axis, std::uint64_t now_us) = 0;
  // Positions, speeds and accelerations of a lift are micrometres where the others have microdegrees.
  /// Finds the index, makes it position 0 and stands there; a failure is FaultCode::homing_failed or no index_found.
  virtual void home(int axis, std::uint64_t now_us) = 0;
  /// Trapezoid to the target, with a jerk an S-curve; the plant plans it. Speed and acceleration are within the
  /// capabilities; jerk_mdeg_per_s3 is 0 where they do not say kTakesJerk.
  virtual void move(int axis, std::int64_t target_udeg, std::uint32_t speed_udeg_per_s,
                    std::uint32_t acceleration_udeg_per_s2, std::uint32_t jerk_mdeg_per_s3, std::uint64_t now_us) = 0;
  /// Decelerates to standing, from any motion; harmless when standing.
  virtual void stop(int axis, std::uint64_t now_us) = 0;
  /// Takes the torque off; the next home() puts it back. What would fall or swing without it is held by a brake or a
  /// self-locking spindle (PROTOCOL.md, section 0).
  virtual void release(int axis, std::uint64_t now_us) = 0;
  /// Exactly these lasers are enabled from now on.
  virtual void set_lasers(std::uint16_t mask, std::uint64_t now_us) = 0;
  virtual void set_lamp(LampPattern pattern, std::uint64_t now_us) = 0;

 protected:
  ~Plant() = default;
};

/// Read-only identity and limits of one machine. Texts: ASCII, at most 32 characters.
struct ControllerConfig {
  const char* vendor = "";
  const char* model = "";
  const char* serial = "";
  std::uint16_t firmware_version = 1;
  std::uint16_t protocol_major = protocol::kMajor, protocol_minor = protocol::kMinor;
  bool simulated = false;
  std::uint16_t axes = 1, lasers = 1;
  std::uint16_t laser_class = protocol::kClass2;
  std::uint16_t lease_max_ms = 500;
  std::uint16_t heartbeat_timeout_ms = 1000;
  std::uint16_t safety_hardware = protocol::kHasWatchdog | protocol::kHasInterlock | protocol::kHasEmergencyStop;
  std::uint16_t session_timeout_ms = 3000;  ///< a host's session ends after so long without its token
  std::uint16_t debounce_ms = 20;
  std::uint16_t laser_off_limit_ms = 100;  ///< light this long after switching off is laser_stuck_on
  /// After power-up or reset a press on the machine is needed before anything moves or shines. False only where no
  /// person can be near the machine.
  bool locked_at_start = true;
  struct Axis {  ///< of a lift micrometres and nanometres instead of microdegrees and nanodegrees
    std::uint16_t kind = protocol::kTurntable;
    std::uint16_t features = protocol::kEndless | protocol::kHasIndex | protocol::kClosedLoop;
    std::int32_t travel_min_udeg = 0, travel_max_udeg = 0;  ///< where not endless
    std::uint32_t encoder_resolution_ndeg = 0;
    std::uint32_t max_speed_udeg_per_s = 0, max_acceleration_udeg_per_s2 = 0;
  } axis[protocol::kMaxAxes];
};

/// One controller. All calls come from one thread or under one lock. Times are microseconds since its start, never
/// before an earlier call's (an earlier time is taken as the latest one; one 10 ms before it is a controller_fault).
class ControllerCore {
 public:
  /// @param boot_id differs from the last start's.
  ControllerCore(const ControllerConfig& config, Plant& plant, std::uint16_t boot_id, std::uint64_t now_us);
  ControllerCore(const ControllerCore&) = delete;
  ControllerCore& operator=(const ControllerCore&) = delete;

  /// Reads the plant, lets leases and the watchdog expire, reacts. Call it at least every millisecond in firmware; a
  /// simulator on an event clock calls it at its own events and at next_deadline_us().
  void step(std::uint64_t now_us);
  /// When step() must run next for leases, watchdog and debouncing to be on time; UINT64_MAX if nothing is pending.
  std::uint64_t next_deadline_us() const;

  // Modbus functions 4, 3, 6 and 16. Each steps first, so that no stale state is read and no expired lease is renewed.
  // A read may have any extent inside the mapped blocks. A write covers whole values: values of one control register,
  // or a run of values of one axis_command block; it is done entirely or, answered with an exception, not at all.
  protocol::Exception read_input(std::uint64_t now_us, std::uint16_t address, std::uint16_t count,
                                 std::uint16_t* words);
  protocol::Exception read_holding(std::uint64_t now_us, std::uint16_t address, std::uint16_t count,
                                   std::uint16_t* words);
  protocol::Exception write_holding(std::uint64_t now_us, std::uint16_t address, std::uint16_t count,
                                    const std::uint16_t* words);

  MotionState motion(int axis) const { return axes_[axis].state; }
  FaultCode fault() const { return fault_; }
  LampPattern lamp() const { return shown_lamp_; }
  std::uint16_t lasers_enabled() const { return enabled_; }
  std::uint16_t button_presses() const { return presses_; }
  /// As of the last step, rounded up; 0 when the laser is off. Feeds no heartbeat.
  std::uint16_t lease_left_ms(int laser) const;
  bool local_action_needed() const { return locked_; }

 private:
  struct Axis {
    AxisSample sample;
    MotionState state = MotionState::unhomed;
    bool homed = false;
    bool stopping = false;         ///< the host asked for a stop; its deceleration runs
    std::int64_t target_udeg = 0;  ///< of the last accepted move or homing
    std::uint16_t last_sequence = 0;
    std::uint16_t command[16] = {};  ///< parameters as last written
  };

  void sense(std::uint64_t now_us);
  void guard();
  void advance_axis(int index);
  void debounce();
  std::uint16_t heartbeat_left_ms() const;
  void show_lamp();
  void feed_heartbeat();
  bool any_motion() const;
  void lasers_off(std::uint16_t mask);
  void halt_all(FaultCode code, std::uint16_t detail);
  void enter_fault(FaultCode code, std::uint16_t detail, int axis = 0);
  void unlock_by_press();

  Refusal safety_refusal() const;
  protocol::Exception refuse(Refusal reason);
  protocol::Exception write_control(std::uint16_t offset, std::uint16_t count, const std::uint16_t* words);
  protocol::Exception write_axis(int index, std::uint16_t offset, std::uint16_t count, const std::uint16_t* words);
  protocol::Exception grant(int first, int count, const std::uint16_t* lease_ms, std::uint16_t token);
  protocol::Exception claim_session(std::uint16_t token);
  protocol::Exception end_session(std::uint16_t token);
  bool may_command(std::uint16_t token);
  protocol::Exception clear_fault();
  protocol::Exception run_command(int index, const std::uint16_t* block);
  protocol::Exception start_move(int index, const std::uint16_t* block);
  void make_safe();

  void put_status(std::uint16_t* words) const;
  void put_axis_status(int index, std::uint16_t* words) const;
  void put_identity(std::uint16_t* words) const;
  void put_capabilities(std::uint16_t* words) const;
  void put_axis_capabilities(int index, std::uint16_t* words) const;
  void put_control(std::uint16_t* words) const;

  const ControllerConfig config_;
  Plant& plant_;
  const std::uint16_t boot_id_;
  std::uint64_t now_us_;

  PlantInputs inputs_;
  Axis axes_[protocol::kMaxAxes];
  FaultCode fault_ = FaultCode::none;
  std::uint16_t fault_detail_ = 0, fault_axis_ = 0;
  Refusal refusal_ = Refusal::none;
  bool locked_;
  bool in_emergency_ = false;

  std::uint16_t session_ = 0;  ///< token of the host that holds the machine; 0: nobody does
  std::uint64_t session_deadline_us_ = 0;

  std::uint64_t heartbeat_deadline_us_ = 0;
  bool host_alive_ = false;

  std::uint16_t enabled_ = 0;
  std::uint64_t lease_deadline_us_[protocol::kMaxLasers] = {};
  std::uint16_t lease_expiries_ = 0;
  std::uint64_t dark_deadline_us_[protocol::kMaxLasers] = {};  ///< by when a laser switched off must be dark

  bool raw_button_ = true, button_ = true;  ///< down until seen released, so that a stuck button is no press
  std::uint64_t button_change_us_ = 0, button_down_us_ = 0;
  std::uint16_t presses_ = 0, button_held_ms_ = 0;

  LampPattern host_lamp_ = LampPattern::off, shown_lamp_ = LampPattern::off;
};

}  // namespace celadon
