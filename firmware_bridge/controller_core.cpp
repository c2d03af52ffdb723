#include "firmware_bridge/controller_core.h"

namespace celadon {

using protocol::Exception;
namespace reg = protocol::reg;

namespace {

constexpr std::uint64_t kNever = ~std::uint64_t{0};
// Callers in several interrupts may bring slightly older times; a clock that goes back further is broken.
constexpr std::uint64_t kClockTolerance_us = 10'000;

constexpr std::uint16_t bit(int index) {
  return static_cast<std::uint16_t>(1u << index);
}

constexpr std::uint16_t saturated_u16(std::uint64_t value) {
  return value > 0xFFFF ? std::uint16_t{0xFFFF} : static_cast<std::uint16_t>(value);
}

// Rounded up, so that 0 means over.
constexpr std::uint16_t left_ms(std::uint64_t deadline_us, std::uint64_t now_us) {
  return deadline_us > now_us ? saturated_u16((deadline_us - now_us + 999) / 1000) : std::uint16_t{0};
}

bool in_motion(MotionState state) {
  return state == MotionState::homing || state == MotionState::moving || state == MotionState::settling;
}

bool is_laser_fault(FaultCode code) {
  return code == FaultCode::laser_stuck_on || code == FaultCode::laser_driver_fault;
}

bool is_forced_stop(FaultCode code) {
  return code != FaultCode::none && static_cast<std::uint16_t>(code) < 16;
}

}  // namespace

ControllerCore::ControllerCore(const ControllerConfig& config, Plant& plant, std::uint16_t boot_id,
                               std::uint64_t now_us)
    : config_(config), plant_(plant), boot_id_(boot_id), now_us_(now_us), locked_(config.locked_at_start) {
  plant_.set_lasers(0, now_us);
  for (int i = 0; i < config_.axes; ++i) plant_.stop(i, now_us);  // whatever ran before a reset does not go on
  for (std::uint64_t& deadline : dark_deadline_us_)
    deadline = now_us + config_.laser_off_limit_ms * std::uint64_t{1000};
  if (!plant_.inputs(now_us).button) raw_button_ = button_ = false;
  plant_.set_lamp(shown_lamp_, now_us);
  sense(now_us);
}

void ControllerCore::step(std::uint64_t now_us) {
  sense(now_us);
}

std::uint64_t ControllerCore::next_deadline_us() const {
  std::uint64_t next = kNever;
  const auto consider = [&next](std::uint64_t deadline) { next = deadline < next ? deadline : next; };
  for (int i = 0; i < config_.lasers; ++i) {
    if (enabled_ & bit(i)) consider(lease_deadline_us_[i]);
    if (!(enabled_ & bit(i)) && dark_deadline_us_[i] > now_us_) consider(dark_deadline_us_[i]);
  }
  if (host_alive_) consider(heartbeat_deadline_us_);
  if (session_ != 0) consider(session_deadline_us_);
  if (raw_button_ != button_) consider(button_change_us_ + config_.debounce_ms * std::uint64_t{1000});
  return next;
}

std::uint16_t ControllerCore::heartbeat_left_ms() const {
  return host_alive_ ? left_ms(heartbeat_deadline_us_, now_us_) : std::uint16_t{0};
}

std::uint16_t ControllerCore::lease_left_ms(int laser) const {
  return (enabled_ & bit(laser)) ? left_ms(lease_deadline_us_[laser], now_us_) : std::uint16_t{0};
}

void ControllerCore::sense(std::uint64_t now_us) {
  const bool went_back = now_us + kClockTolerance_us < now_us_;
  if (now_us > now_us_) now_us_ = now_us;
  inputs_ = plant_.inputs(now_us_);
  for (int i = 0; i < config_.axes; ++i) axes_[i].sample = plant_.axis(i, now_us_);
  // With a clock that stands still until it has caught up, no lease would end.
  if (went_back && inputs_.fault == FaultCode::none) inputs_.fault = FaultCode::controller_fault;
  guard();
  for (int i = 0; i < config_.axes; ++i) advance_axis(i);
  debounce();
  show_lamp();
}

// Everything that takes lasers and motion away, in one place.
void ControllerCore::guard() {
  for (int i = 0; i < config_.lasers; ++i) {
    if ((enabled_ & bit(i)) && now_us_ >= lease_deadline_us_[i]) {
      lasers_off(bit(i));
      ++lease_expiries_;
    }
  }
  if (session_ != 0 && now_us_ >= session_deadline_us_) session_ = 0;
  if (host_alive_ && now_us_ >= heartbeat_deadline_us_) {
    host_alive_ = false;
    if (enabled_ || any_motion()) halt_all(FaultCode::heartbeat_lost, 0);
  }
  if (inputs_.emergency_stop) {
    locked_ = true;
    lasers_off(enabled_);
    for (int i = 0; i < config_.axes; ++i) {
      Axis& axis = axes_[i];
      if (!in_emergency_) plant_.release(i, now_us_);  // hardware has cut the power: the table may be turned by hand
      if (axis.state != MotionState::fault) axis.state = MotionState::stopped;
      axis.homed = axis.stopping = false;
    }
    if (fault_ == FaultCode::none || is_forced_stop(fault_)) {
      fault_ = FaultCode::emergency_stop;
      fault_detail_ = fault_axis_ = 0;
    }
  }
  in_emergency_ = inputs_.emergency_stop;
  if (!inputs_.interlock_closed) {
    locked_ = true;
    if (enabled_ || any_motion()) halt_all(FaultCode::interlock_opened, 0);
  }
  for (int i = 0; i < config_.lasers; ++i) {
    const bool emits = inputs_.lasers_measured & bit(i);
    if (emits && !(enabled_ & bit(i)) && now_us_ >= dark_deadline_us_[i])
      enter_fault(FaultCode::laser_stuck_on, static_cast<std::uint16_t>(i));
  }
  if (inputs_.fault != FaultCode::none) enter_fault(inputs_.fault, inputs_.fault_detail);
  for (int i = 0; i < config_.axes; ++i) {
    if (axes_[i].sample.fault != FaultCode::none) enter_fault(axes_[i].sample.fault, axes_[i].sample.fault_detail, i);
  }
}

void ControllerCore::advance_axis(int index) {
  Axis& axis = axes_[index];
  const AxisPhase phase = axis.sample.phase;
  if (axis.state == MotionState::homing) {
    if (phase != AxisPhase::standing) return;
    if (axis.stopping) {
      axis.state = MotionState::unhomed;
      axis.stopping = false;
    } else if (axis.sample.index_found) {
      axis.homed = true;
      axis.state = MotionState::standstill;
    } else {
      enter_fault(FaultCode::homing_failed, 0, index);
    }
  } else if (axis.state == MotionState::moving || axis.state == MotionState::settling) {
    axis.state = phase == AxisPhase::standing   ? MotionState::standstill
                 : phase == AxisPhase::settling ? MotionState::settling
                                                : MotionState::moving;
    if (phase == AxisPhase::standing) axis.stopping = false;
  }
}

void ControllerCore::debounce() {
  if (inputs_.button != raw_button_) {
    raw_button_ = inputs_.button;
    button_change_us_ = now_us_;
  }
  if (raw_button_ != button_ && now_us_ >= button_change_us_ + config_.debounce_ms * std::uint64_t{1000}) {
    button_ = raw_button_;
    if (button_) {
      ++presses_;
      button_down_us_ = button_change_us_;
      unlock_by_press();
    } else {
      button_held_ms_ = saturated_u16((button_change_us_ - button_down_us_) / 1000);
    }
  }
  if (button_ && presses_ != 0) button_held_ms_ = saturated_u16((now_us_ - button_down_us_) / 1000);
}

void ControllerCore::show_lamp() {
  LampPattern pattern = host_alive_ ? host_lamp_ : LampPattern::off;
  bool fault = inputs_.emergency_stop;
  for (int i = 0; i < config_.axes; ++i) fault = fault || axes_[i].state == MotionState::fault;
  if (locked_) pattern = LampPattern::attention;
  if (fault) pattern = LampPattern::fault;
  if (pattern != shown_lamp_) plant_.set_lamp(pattern, now_us_);
  shown_lamp_ = pattern;
}

void ControllerCore::feed_heartbeat() {
  host_alive_ = true;
  heartbeat_deadline_us_ = now_us_ + config_.heartbeat_timeout_ms * std::uint64_t{1000};
}

bool ControllerCore::any_motion() const {
  for (int i = 0; i < config_.axes; ++i) {
    if (in_motion(axes_[i].state)) return true;
  }
  return false;
}

void ControllerCore::lasers_off(std::uint16_t mask) {
  const auto off = static_cast<std::uint16_t>(mask & enabled_);
  if (off == 0) return;
  enabled_ = static_cast<std::uint16_t>(enabled_ & ~off);
  plant_.set_lasers(enabled_, now_us_);
  for (int i = 0; i < config_.lasers; ++i) {
    if (off & bit(i)) dark_deadline_us_[i] = now_us_ + config_.laser_off_limit_ms * std::uint64_t{1000};
  }
}

void ControllerCore::halt_all(FaultCode code, std::uint16_t detail) {
  lasers_off(enabled_);
  for (int i = 0; i < config_.axes; ++i) {
    Axis& axis = axes_[i];
    if (!in_motion(axis.state)) continue;
    plant_.stop(i, now_us_);
    if (axis.state == MotionState::homing) axis.homed = false;
    axis.state = MotionState::stopped;
    axis.stopping = false;
  }
  fault_ = code;
  fault_detail_ = detail;
  fault_axis_ = 0;
}

void ControllerCore::enter_fault(FaultCode code, std::uint16_t detail, int axis) {
  lasers_off(enabled_);
  // The first fault is the one to report; those that follow from it are not.
  if (fault_ != FaultCode::none && !is_forced_stop(fault_)) return;
  for (int i = 0; i < config_.axes; ++i) {
    if (is_laser_fault(code)) {
      plant_.stop(i, now_us_);
    } else {
      plant_.release(i, now_us_);
    }
    axes_[i].state = MotionState::fault;
    axes_[i].homed = axes_[i].stopping = false;
  }
  fault_ = code;
  fault_detail_ = detail;
  fault_axis_ = static_cast<std::uint16_t>(axis);
}

// The deliberate action at the machine: after it commands are accepted again, nothing starts by it.
void ControllerCore::unlock_by_press() {
  if (!inputs_.interlock_closed || inputs_.emergency_stop) return;
  locked_ = false;
  bool all_released = true;
  for (int i = 0; i < config_.axes; ++i) {
    Axis& axis = axes_[i];
    if (axis.state != MotionState::stopped) continue;
    if (axis.sample.phase == AxisPhase::standing) {
      axis.state = axis.homed ? MotionState::standstill : MotionState::unhomed;
    } else {
      all_released = false;
    }
  }
  if (all_released && is_forced_stop(fault_)) fault_ = FaultCode::none;
}

// ---- commands ----

Exception ControllerCore::refuse(Refusal reason) {
  refusal_ = reason;
  return Exception::refused;
}

Refusal ControllerCore::safety_refusal() const {
  if (inputs_.emergency_stop) return Refusal::emergency_stop;
  if (!inputs_.interlock_closed) return Refusal::interlock_open;
  if (locked_) return Refusal::local_action_needed;
  return Refusal::none;
}

void ControllerCore::make_safe() {
  lasers_off(enabled_);
  for (int i = 0; i < config_.axes; ++i) {
    if (!in_motion(axes_[i].state)) continue;
    plant_.stop(i, now_us_);
    axes_[i].stopping = true;
  }
}

Exception ControllerCore::claim_session(std::uint16_t token) {
  if (token == 0) return Exception::illegal_value;
  if (session_ != 0 && session_ != token) return refuse(Refusal::session_held);
  session_ = token;
  session_deadline_us_ = now_us_ + config_.session_timeout_ms * std::uint64_t{1000};
  return Exception::none;
}

Exception ControllerCore::end_session(std::uint16_t token) {
  if (session_ != 0 && session_ != token) return refuse(Refusal::session_held);
  session_ = 0;
  return Exception::none;
}

// While a session is held, what starts something carries its token, and keeps it.
bool ControllerCore::may_command(std::uint16_t token) {
  if (session_ == 0) return true;
  if (session_ != token) return false;
  session_deadline_us_ = now_us_ + config_.session_timeout_ms * std::uint64_t{1000};
  return true;
}

Exception ControllerCore::grant(int first, int count, const std::uint16_t* lease_ms, std::uint16_t token) {
  const bool some_stay = first == 0 && token != 0;
  const auto stays = [&](int i) { return some_stay && lease_ms[i] == protocol::kLeaseUnchanged; };
  bool any_on = false;
  for (int i = 0; i < count; ++i) {
    if (stays(i)) continue;
    if (lease_ms[i] > config_.lease_max_ms) return Exception::illegal_value;
    any_on = any_on || lease_ms[i] != 0;
  }
  if (any_on && !may_command(token)) return refuse(Refusal::session_held);
  if (any_on) {
    if (const Refusal reason = safety_refusal(); reason != Refusal::none) return refuse(reason);
    for (int i = 0; i < config_.axes; ++i) {
      if (axes_[i].state == MotionState::fault) return refuse(Refusal::fault);
      if (axes_[i].state == MotionState::stopped) return refuse(Refusal::stopped);
    }
    fault_ = FaultCode::none;
  }
  std::uint16_t off = 0, on = 0;
  for (int i = 0; i < count; ++i) {
    const std::uint16_t laser = bit(first + i);
    if (stays(i)) continue;
    if (lease_ms[i] == 0) {
      off = static_cast<std::uint16_t>(off | laser);
    } else {
      on = static_cast<std::uint16_t>(on | laser);
      lease_deadline_us_[first + i] = now_us_ + lease_ms[i] * std::uint64_t{1000};
    }
  }
  lasers_off(off);
  if (on & ~enabled_) {
    enabled_ = static_cast<std::uint16_t>(enabled_ | on);
    plant_.set_lasers(enabled_, now_us_);
  }
  return Exception::none;
}

Exception ControllerCore::clear_fault() {
  if (const Refusal reason = safety_refusal(); reason != Refusal::none) return refuse(reason);
  if (inputs_.fault != FaultCode::none || (inputs_.lasers_measured & ~enabled_)) return refuse(Refusal::cause_persists);
  for (int i = 0; i < config_.axes; ++i) {
    if (axes_[i].sample.fault != FaultCode::none) return refuse(Refusal::cause_persists);
    const bool held = axes_[i].state == MotionState::stopped || axes_[i].state == MotionState::fault;
    if (held && axes_[i].sample.phase != AxisPhase::standing) return refuse(Refusal::moving);
  }
  for (int i = 0; i < config_.axes; ++i) {
    Axis& axis = axes_[i];
    if (axis.state == MotionState::stopped || axis.state == MotionState::fault)
      axis.state = axis.homed ? MotionState::standstill : MotionState::unhomed;
  }
  fault_ = FaultCode::none;
  fault_detail_ = fault_axis_ = 0;
  return Exception::none;
}

Exception ControllerCore::run_command(int index, const std::uint16_t* block) {
  Axis& axis = axes_[index];
  const std::uint16_t command = block[reg::axis_command::command.offset];
  if (command == protocol::kNoCommand) return Exception::none;
  if (command > protocol::kStop) return Exception::illegal_value;
  if (command == protocol::kStop) {
    plant_.stop(index, now_us_);
    if (in_motion(axis.state)) axis.stopping = true;
    return Exception::none;
  }
  if (!may_command(block[reg::axis_command::session.offset])) return refuse(Refusal::session_held);
  if (const Refusal reason = safety_refusal(); reason != Refusal::none) return refuse(reason);
  if (axis.state == MotionState::fault) return refuse(Refusal::fault);
  if (in_motion(axis.state) || axis.sample.phase != AxisPhase::standing) return refuse(Refusal::moving);
  if (command == protocol::kMove) return start_move(index, block);
  axis.state = MotionState::homing;
  axis.homed = axis.stopping = false;
  axis.target_udeg = 0;
  fault_ = FaultCode::none;
  plant_.home(index, now_us_);
  return Exception::none;
}

Exception ControllerCore::start_move(int index, const std::uint16_t* block) {
  Axis& axis = axes_[index];
  if (axis.state == MotionState::stopped) return refuse(Refusal::stopped);
  if (axis.state == MotionState::unhomed) return refuse(Refusal::unhomed);
  const ControllerConfig::Axis& limits = config_.axis[index];
  const std::uint32_t speed = protocol::get_u32(block + reg::axis_command::goal_speed.offset);
  std::uint32_t acceleration = protocol::get_u32(block + reg::axis_command::goal_acceleration.offset);
  if (acceleration == 0) acceleration = limits.max_acceleration_udeg_per_s2;
  if (speed == 0 || speed > limits.max_speed_udeg_per_s) return Exception::illegal_value;
  if (acceleration > limits.max_acceleration_udeg_per_s2) return Exception::illegal_value;
  const std::uint32_t jerk = protocol::get_u32(block + reg::axis_command::goal_jerk.offset);
  if (jerk != 0 && !(limits.features & protocol::kTakesJerk)) return Exception::illegal_value;
  const std::int64_t target = protocol::join_turns(protocol::get_s32(block + reg::axis_command::goal_angle.offset),
                                                   protocol::get_s32(block + reg::axis_command::goal_turns.offset));
  if (limits.features & protocol::kEndless) {
    constexpr std::int64_t kFar = protocol::kTurn_udeg * (std::int64_t{1} << 30);  // reported turns cannot overflow
    if (target > kFar || target < -kFar) return refuse(Refusal::beyond_travel);
  } else if (target < limits.travel_min_udeg || target > limits.travel_max_udeg) {
    return refuse(Refusal::beyond_travel);
  }
  axis.state = MotionState::moving;
  axis.stopping = false;
  axis.target_udeg = target;
  fault_ = FaultCode::none;
  plant_.move(index, target, speed, acceleration, jerk, now_us_);
  return Exception::none;
}

}  // namespace celadon
