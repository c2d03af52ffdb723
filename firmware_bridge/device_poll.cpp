#include "firmware_bridge/device_poll.h"

#include <cmath>
#include <cstdio>
#include <numbers>
#include <random>
#include <utility>

#include "firmware_bridge/status_check.h"

namespace celadon {
namespace {

using Kind = DeviceError::Kind;
namespace reg = protocol::reg;

constexpr double kDegree = std::numbers::pi / 180;
// An encoder's speed trembles at standstill.
constexpr double kStandingSpeed_rad_per_s = 0.1 * kDegree, kStandingSpeed_mm_per_s = 0.1;
constexpr AxisKind kOtherKinds[] = {AxisKind::elevation, AxisKind::lift};

const std::optional<AxisStatus>& other_axis(const DeviceStatus& s, AxisKind kind) {
  return kind == AxisKind::lift ? s.lift : s.elevation;
}

}  // namespace

const char* axis_name(AxisKind kind) {
  return kind == AxisKind::turntable ? "table" : kind == AxisKind::elevation ? "elevation" : "lift";
}

std::string position_text(AxisKind kind, double position) {
  char text[32];
  if (kind == AxisKind::lift) {
    std::snprintf(text, sizeof text, "%.3f mm", position);
  } else {
    std::snprintf(text, sizeof text, "%.3f deg", position / kDegree);
  }
  return text;
}

const char* state_name(MotionState state) {
  return protocol::find_code(protocol::kMotionStates, static_cast<std::uint16_t>(state)).name;
}

bool in_motion(MotionState state) {
  return state == MotionState::homing || state == MotionState::moving || state == MotionState::settling;
}

bool is_standing(AxisKind kind, const AxisStatus& axis) {
  const double slow = kind == AxisKind::lift ? kStandingSpeed_mm_per_s : kStandingSpeed_rad_per_s;
  return !in_motion(axis.motion) && std::abs(axis.speed) < slow;
}

bool is_dark(const StatusBlock& block) {
  return block.status.lasers_on == 0 && block.lasers_enabled == 0;
}

bool all_standing(const StatusBlock& block) {
  for (int i = 0; i < block.axes; ++i) {
    if (in_motion(block.motion[static_cast<std::size_t>(i)])) return false;  // of a kind unknown here, too
  }
  if (!is_standing(AxisKind::turntable, axis_status(block.status, AxisKind::turntable))) return false;
  return std::all_of(std::begin(kOtherKinds), std::end(kOtherKinds), [&](AxisKind kind) {
    const auto& axis = other_axis(block.status, kind);
    return !axis || is_standing(kind, *axis);
  });
}

Refusal safety_refusal(const DeviceStatus& s) {
  if (s.emergency_stop) return Refusal::emergency_stop;
  if (!s.interlock_closed) return Refusal::interlock_open;
  if (s.local_action_needed) return Refusal::local_action_needed;
  return Refusal::none;
}

AxisStatus axis_status(const DeviceStatus& s, AxisKind kind) {
  if (kind != AxisKind::turntable) return other_axis(s, kind).value();
  return {s.motion, s.homed, s.angle_rad, s.target_rad, s.speed_rad_per_s, s.position_counter, s.position_time_us};
}

// ---- what is known, and how it is told ----

std::string DevicePoll::state_left() const {
  if (!link_is_up || !last) {
    std::string text = "its state unknown: the link is down";
    if (capabilities.host_watchdog)
      text += "; the controller turns the lasers off within " + std::to_string(capabilities.lease_ms) +
              " ms and stops the motor within " + std::to_string(capabilities.heartbeat_timeout_ms) + " ms by itself";
    return text;
  }
  const DeviceStatus& s = last->status;
  const auto told = [](AxisKind kind, const AxisStatus& axis) {
    return std::string(is_standing(kind, axis)       ? "standing ("
                       : kind == AxisKind::turntable ? "turning ("
                                                     : "moving (") +
           state_name(axis.motion) + " at " + position_text(kind, axis.position) + ")";
  };
  std::string text = std::string(is_dark(*last) ? "lasers off" : "a laser on") + ", motor " +
                     told(AxisKind::turntable, axis_status(s, AxisKind::turntable));
  for (const AxisKind kind : kOtherKinds) {
    if (const auto& axis = other_axis(s, kind)) text += std::string(", ") + axis_name(kind) + " " + told(kind, *axis);
  }
  return text;
}

DeviceError DevicePoll::error(Kind kind, const std::string& operation, std::string cause, std::string remedy) const {
  return {kind, operation, link.url(), std::move(cause), state_left(), std::move(remedy)};
}

DeviceError DevicePoll::failure(const std::string& operation, LinkError cause) {
  if (cause.kind == Kind::refused && cause.code == static_cast<int>(protocol::Exception::refused)) {
    if (refresh() && last->refusal != Refusal::none) return refusal(operation, last->refusal);
  }
  if (cause.kind == Kind::lost || cause.kind == Kind::timed_out || cause.kind == Kind::broken_reply ||
      cause.kind == Kind::not_found)
    link_is_up = false;
  const bool silent = cause.kind == Kind::timed_out;
  return error(cause.kind, operation, std::move(cause.cause),
               silent ? "check cable, power, unit number and serial settings" : "");
}

DeviceError DevicePoll::refusal(const std::string& operation, Refusal reason) const {
  const auto code = protocol::find_code(protocol::kRefusals, static_cast<std::uint16_t>(reason));
  const std::string cause = std::string("the controller refused it: ") + code.meaning;
  switch (reason) {
    case Refusal::interlock_open:
      return error(Kind::interlock, operation, cause, "close the cover, then press the button on the machine");
    case Refusal::emergency_stop:
      return error(Kind::interlock, operation, cause,
                   "release the emergency stop, then press the button on the machine");
    case Refusal::local_action_needed:
      return error(Kind::interlock, operation, cause, "press the button on the machine");
    case Refusal::fault:
    case Refusal::cause_persists:
      return fault_error(operation);
    case Refusal::stopped:
      return error(Kind::wrong_state, operation,
                   cause + (last && !last->status.fault_text.empty() ? ", because " + last->status.fault_text : ""));
    case Refusal::session_held:
      return error(Kind::refused, operation, cause, "end the other program, or wait until it lets go of the machine");
    case Refusal::unhomed:
      return error(Kind::wrong_state, operation, cause, "home it first");
    default:
      return error(Kind::wrong_state, operation, cause);
  }
}

DeviceError DevicePoll::fault_error(const std::string& operation) const {
  const DeviceStatus& s = last->status;
  const auto code = protocol::find_code(protocol::kFaultCodes, s.fault_code);
  const std::string cause = "the controller reports " + std::string(code.name) + " (code " +
                            std::to_string(s.fault_code) + "): " + s.fault_text;
  const auto fault = static_cast<FaultCode>(s.fault_code);
  if (fault == FaultCode::interlock_opened || fault == FaultCode::emergency_stop)
    return error(Kind::interlock, operation, cause,
                 "close the cover, release the emergency stop, then press the button on the machine");
  if (fault == FaultCode::heartbeat_lost) return error(Kind::fault, operation, cause, "home again");
  return error(Kind::fault, operation, cause, "remove the cause, clear the fault, then home");
}

// ---- polling ----

tl::expected<void, LinkError> DevicePoll::refresh() {
  auto block = link.read_status();
  if (block && last && block->status.boot_id == last->status.boot_id &&
      block->status.uptime_us < last->status.uptime_us) {
    // Either a late reply from before, or a controller that forgot its boot number: the next read tells.
    block = link.read_status();
    if (block && block->status.uptime_us < last->status.uptime_us) restarted_ = true;
  }
  if (!block) return tl::unexpected(std::move(block.error()));
  link_is_up = true;
  if (last) {
    restarted_ = restarted_ || block->status.boot_id != last->status.boot_id;
    if (!restarted_) compare_with_last(*block);
    const std::uint16_t seen = restarted_ ? std::uint16_t{0} : last->status.button_presses;
    const auto fresh = static_cast<std::uint16_t>(block->status.button_presses - seen);
    presses = static_cast<std::uint16_t>(std::min<int>(presses + fresh, 0xFFFF));
  }
  last = std::move(*block);
  const auto lost = [this](AxisKind kind) {
    const auto at = link.block_of(kind);
    return at && position_is_lost_[static_cast<std::size_t>(*at)];
  };
  if (lost(AxisKind::turntable)) last->status.homed = false;
  if (last->status.elevation && lost(AxisKind::elevation)) last->status.elevation->homed = false;
  if (last->status.lift && lost(AxisKind::lift)) last->status.lift->homed = false;
  // Never backwards: a command given up on may still arrive, and must not carry the next one's number.
  for (std::size_t i = 0; i < sequence_.size(); ++i) {
    const auto ahead = static_cast<std::int16_t>(last->command_sequence[i] - sequence_[i]);
    if (ahead > 0 || restarted_) sequence_[i] = last->command_sequence[i];
  }
  return {};
}

void DevicePoll::compare_with_last(const StatusBlock& block) {
  const auto commanded = [&](int at) {
    return block.command_sequence[static_cast<std::size_t>(at)] != last->command_sequence[static_cast<std::size_t>(at)];
  };
  auto jump = contradiction(last->status, block.status, commanded(0), capabilities);
  int at = 0;
  for (const AxisKind kind : kOtherKinds) {
    const auto &before = other_axis(last->status, kind), &now = other_axis(block.status, kind);
    const auto& limits = kind == AxisKind::lift ? capabilities.lift : capabilities.elevation;
    if (jump || !before || !now || !limits) continue;
    at = link.block_of(kind).value_or(0);
    if (auto cause = position_jump(kind, *before, *now, commanded(at), limits->max_acceleration))
      jump = Contradiction{*std::move(cause), true};
  }
  if (!jump) return;
  if (jump->position) position_is_lost_[static_cast<std::size_t>(at)] = true;
  jumped_ = std::move(jump->cause);
}

tl::expected<void, DeviceError> DevicePoll::poll(const std::string& operation) {
  if (auto done = refresh(); !done) return tl::unexpected(failure(operation, std::move(done.error())));
  if (std::exchange(restarted_, false)) {
    session_due_ns_ = 0;  // the controller has forgotten it
    return tl::unexpected(error(Kind::fault, operation,
                                "the controller restarted (power-up or reset) and resumed nothing",
                                "press the button on the machine if it asks for it, then home"));
  }
  if (jumped_) {
    const std::string cause = *std::exchange(jumped_, std::nullopt);
    return tl::unexpected(error(Kind::fault, operation, cause, "home again"));
  }
  if (link.token() != 0 && now_ns() >= session_due_ns_) return hold_session(operation);
  return {};
}

// ---- session: one host commands ----

tl::expected<void, DeviceError> DevicePoll::hold_session(const std::string& operation) {
  auto written = write(reg::control::session, link.token());
  if (!written) return tl::unexpected(failure(operation, std::move(written.error())));
  session_due_ns_ = now_ns() + capabilities.session_timeout_ms * kMillisecond_ns / 3;
  return {};
}

tl::expected<void, DeviceError> DevicePoll::take_machine(const std::string& operation) {
  if (identity.protocol_minor < protocol::kSessionMinor || capabilities.session_timeout_ms == 0) return {};
  link.use_token(static_cast<std::uint16_t>(1 + std::random_device{}() % 0xFFFF));
  const std::int64_t deadline_ns = now_ns() + 3 * capabilities.session_timeout_ms * kMillisecond_ns / 2;
  for (;;) {
    auto held = hold_session(operation);
    if (held || now_ns() >= deadline_ns || held.error().kind != Kind::refused) return held;
    link.clock().sleep_until(now_ns() + 5 * kPollPeriod_ns);
  }
}

void DevicePoll::begin_anew() {
  presses = 0;
  restarted_ = false;
  jumped_.reset();
}

std::uint16_t DevicePoll::next_sequence(int block) {
  std::uint16_t& sequence = sequence_[static_cast<std::size_t>(block)];
  sequence = static_cast<std::uint16_t>(sequence == 0xFFFF ? 1 : sequence + 1);  // 0 means "always execute"
  return sequence;
}

}  // namespace celadon
