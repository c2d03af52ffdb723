#include "firmware_bridge/scanner_device.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <initializer_list>
#include <numbers>
#include <optional>
#include <random>
#include <utility>

#include "firmware_bridge/controller_link.h"
#include "firmware_bridge/status_check.h"

namespace celadon {
namespace {

using Kind = DeviceError::Kind;
namespace reg = protocol::reg;

constexpr std::int64_t kMillisecond_ns = 1'000'000;
constexpr std::int64_t kPollPeriod_ns = 20 * kMillisecond_ns;
constexpr std::int64_t kHomingLimit_ns = 120'000 * kMillisecond_ns;
constexpr std::int64_t kStartLimit_ns = 2'000 * kMillisecond_ns;
constexpr std::int64_t kDarkLimit_ns = 500 * kMillisecond_ns;
constexpr double kUdeg_per_rad = 180e6 / std::numbers::pi, kMdeg_per_rad = 180e3 / std::numbers::pi;
// Where a controller claims to stand on its target but is further away, steps were lost or someone else moved it.
constexpr double kOnTarget_rad = 0.05 * std::numbers::pi / 180;

std::string degrees(double rad) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3f deg", rad * 180 / std::numbers::pi);
  return text;
}

const char* state_name(MotionState state) {
  return protocol::find_code(protocol::kMotionStates, static_cast<std::uint16_t>(state)).name;
}

bool in_motion(const DeviceStatus& s) {
  return s.motion == MotionState::homing || s.motion == MotionState::moving || s.motion == MotionState::settling;
}

bool is_dark(const StatusBlock& block) {
  return block.status.lasers_on == 0 && block.lasers_enabled == 0;
}
// An encoder's speed trembles at standstill.
constexpr double kStandingSpeed_rad_per_s = 0.1 * std::numbers::pi / 180;
bool is_standing(const DeviceStatus& s) {
  return !in_motion(s) && std::abs(s.speed_rad_per_s) < kStandingSpeed_rad_per_s;
}

std::int64_t nanoseconds(double seconds) {
  return static_cast<std::int64_t>(std::min(seconds, 1e9) * 1e9);
}

}  // namespace

struct ScannerDevice::Impl {
  Impl(std::unique_ptr<Transport> transport, Clock& clock) : link(std::move(transport), clock) {}

  ControllerLink link;
  DeviceIdentity identity;
  DeviceCapabilities capabilities;
  SafeReport found;
  std::optional<StatusBlock> last;  // newest status; presses and sequence continue from it
  bool link_is_up = false;
  std::uint16_t sequence = 0;  // of the last motion command sent
  std::uint16_t presses = 0;   // seen, not yet taken
  bool restarted = false;      // the controller, and the owner has not been told

  std::optional<std::string> jumped;  // clock or position, and the owner has not been told
  bool position_is_lost = false;      // since such a jump

  std::function<std::optional<std::string>()> interrupted;  // the owner's wish to end a motion early

  MotionLimits limits;

  std::int64_t session_due_ns = 0;  // when the token has to be written again

  std::int64_t now_ns() { return link.clock().now_ns(); }

  // ---- what is known, and how it is told ----

  std::string state_left() const {
    if (!link_is_up || !last) {
      std::string text = "its state unknown: the link is down";
      if (capabilities.host_watchdog)
        text += "; the controller turns the lasers off within " + std::to_string(capabilities.lease_ms) +
                " ms and stops the motor within " + std::to_string(capabilities.heartbeat_timeout_ms) + " ms by itself";
      return text;
    }
    const DeviceStatus& s = last->status;
    return std::string(is_dark(*last) ? "lasers off" : "a laser on") + ", motor " +
           (is_standing(s) ? "standing" : "turning") + " (" + state_name(s.motion) + " at " + degrees(s.angle_rad) +
           ")";
  }

  DeviceError error(Kind kind, const std::string& operation, std::string cause, std::string remedy = {}) const {
    return {kind, operation, link.url(), std::move(cause), state_left(), std::move(remedy)};
  }

  // A failed exchange of `operation`; reads the controller's own reason where it refused.
  DeviceError failure(const std::string& operation, LinkError cause) {
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

  DeviceError refusal(const std::string& operation, Refusal reason) const {
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

  DeviceError fault_error(const std::string& operation) const {
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

  // One block read into `last`; counts presses and notices a restart.
  tl::expected<void, LinkError> refresh() {
    auto block = link.read_status();
    if (block && last && block->status.boot_id == last->status.boot_id &&
        block->status.uptime_us < last->status.uptime_us) {
      // Either a late reply from before, or a controller that forgot its boot number: the next read tells.
      block = link.read_status();
      if (block && block->status.uptime_us < last->status.uptime_us) restarted = true;
    }
    if (!block) return tl::unexpected(std::move(block.error()));
    link_is_up = true;
    if (last) {
      restarted = restarted || block->status.boot_id != last->status.boot_id;
      if (!restarted) compare_with_last(*block);
      const std::uint16_t seen = restarted ? std::uint16_t{0} : last->status.button_presses;
      const auto fresh = static_cast<std::uint16_t>(block->status.button_presses - seen);
      presses = static_cast<std::uint16_t>(std::min<int>(presses + fresh, 0xFFFF));
    }
    last = std::move(*block);
    if (position_is_lost) last->status.homed = false;
    // Never backwards: a command given up on may still arrive, and must not carry the next one's number.
    const auto ahead = static_cast<std::int16_t>(last->command_sequence - sequence);
    if (ahead > 0 || restarted) sequence = last->command_sequence;
    return {};
  }

  void compare_with_last(const StatusBlock& block) {
    const bool commanded = block.command_sequence != last->command_sequence;
    auto jump = contradiction(last->status, block.status, commanded, capabilities);
    if (!jump) return;
    position_is_lost = position_is_lost || jump->position;
    jumped = std::move(jump->cause);
  }

  tl::expected<void, DeviceError> poll(const std::string& operation) {
    if (auto done = refresh(); !done) return tl::unexpected(failure(operation, std::move(done.error())));
    if (std::exchange(restarted, false)) {
      session_due_ns = 0;  // the controller has forgotten it
      return tl::unexpected(error(Kind::fault, operation,
                                  "the controller restarted (power-up or reset) and resumed nothing",
                                  "press the button on the machine if it asks for it, then home"));
    }
    if (jumped) {
      const std::string cause = *std::exchange(jumped, std::nullopt);
      return tl::unexpected(error(Kind::fault, operation, cause, "home again"));
    }
    if (link.token() != 0 && now_ns() >= session_due_ns) return hold_session(operation);
    return {};
  }

  // ---- session: one host commands ----

  tl::expected<void, DeviceError> hold_session(const std::string& operation) {
    auto written = write(reg::control::session, link.token());
    if (!written) return tl::unexpected(failure(operation, std::move(written.error())));
    session_due_ns = now_ns() + capabilities.session_timeout_ms * kMillisecond_ns / 3;
    return {};
  }

  // A host that was killed holds the machine until its session is over.
  tl::expected<void, DeviceError> take_machine(const std::string& operation) {
    if (identity.protocol_minor < protocol::kSessionMinor || capabilities.session_timeout_ms == 0) return {};
    link.use_token(static_cast<std::uint16_t>(1 + std::random_device{}() % 0xFFFF));
    const std::int64_t deadline_ns = now_ns() + 3 * capabilities.session_timeout_ms * kMillisecond_ns / 2;
    for (;;) {
      auto held = hold_session(operation);
      if (held || now_ns() >= deadline_ns || held.error().kind != Kind::refused) return held;
      link.clock().sleep_until(now_ns() + 5 * kPollPeriod_ns);
    }
  }

  // Polls until `done` holds; the deadline is on the clock.
  template <class Predicate>
  tl::expected<void, DeviceError> wait_until(const std::string& operation, std::int64_t limit_ns, Predicate done) {
    const std::int64_t deadline_ns = now_ns() + limit_ns;
    for (;;) {
      if (auto polled = poll(operation); !polled) return polled;
      if (done()) return {};
      if (now_ns() >= deadline_ns)
        return tl::unexpected(
            error(Kind::timed_out, operation,
                  "it was not finished within " + std::to_string(limit_ns / kMillisecond_ns) + " ms"));
      link.wait_until(std::min(now_ns() + kPollPeriod_ns, deadline_ns));
    }
  }

  tl::expected<void, LinkError> write(const protocol::Register& r, std::uint16_t value, int index = 0) {
    return link.write(r, index, std::span(&value, 1));
  }

  // ---- motion ----

  static Refusal safety_refusal(const DeviceStatus& s) {
    if (s.emergency_stop) return Refusal::emergency_stop;
    if (!s.interlock_closed) return Refusal::interlock_open;
    if (s.local_action_needed) return Refusal::local_action_needed;
    return Refusal::none;
  }

  // Polls, and refuses here what the state does not allow.
  tl::expected<void, DeviceError> require(const std::string& operation, std::initializer_list<MotionState> allowed) {
    if (auto polled = poll(operation); !polled) return polled;
    const DeviceStatus& s = last->status;
    if (const Refusal reason = safety_refusal(s); reason != Refusal::none)
      return tl::unexpected(refusal(operation, reason));
    if (std::find(allowed.begin(), allowed.end(), s.motion) != allowed.end()) return {};
    if (s.motion == MotionState::fault) return tl::unexpected(fault_error(operation));
    if (s.motion == MotionState::stopped) return tl::unexpected(refusal(operation, Refusal::stopped));
    if (s.motion == MotionState::unhomed) return tl::unexpected(refusal(operation, Refusal::unhomed));
    return tl::unexpected(refusal(operation, Refusal::moving));
  }

  Refusal laser_refusal() const {
    const DeviceStatus& s = last->status;
    if (s.motion == MotionState::fault) return Refusal::fault;
    if (const Refusal reason = safety_refusal(s); reason != Refusal::none) return reason;
    return s.motion == MotionState::stopped ? Refusal::stopped : Refusal::none;
  }

  // Waits for the end of a motion; one that fails or is interrupted is stopped.
  tl::expected<void, DeviceError> finish_motion(const std::string& operation, std::int64_t limit_ns) {
    std::optional<std::string> cut;
    auto ended = wait_until(operation, limit_ns, [&] {
      if (in_motion(last->status) && interrupted) cut = interrupted();
      return cut || !in_motion(last->status);
    });
    if (ended && !cut) return require_standstill(operation);
    make_safe();
    if (cut) return tl::unexpected(error(Kind::interrupted, operation, *cut));
    ended.error().left = state_left();
    return ended;
  }

  std::uint16_t next_sequence() {
    sequence = static_cast<std::uint16_t>(sequence == 0xFFFF ? 1 : sequence + 1);  // 0 means "always execute"
    return sequence;
  }

  tl::expected<void, DeviceError> command(const std::string& operation, std::uint16_t code,
                                          std::int64_t target_udeg = 0, std::uint32_t speed_udeg_per_s = 0,
                                          std::uint32_t jerk_mdeg_per_s3 = 0) {
    auto sent = link.write_axis_command(code, next_sequence(), target_udeg, speed_udeg_per_s, jerk_mdeg_per_s3);
    if (!sent) return tl::unexpected(failure(operation, std::move(sent.error())));
    return {};
  }

  tl::expected<void, DeviceError> send_move(const std::string& operation, double angle_rad, double speed_rad_per_s) {
    const double target_udeg = std::round(angle_rad * kUdeg_per_rad);
    const double speed_udeg = std::round(speed_rad_per_s * kUdeg_per_rad);
    const double max_speed_udeg = std::round(capabilities.max_speed_rad_per_s * kUdeg_per_rad);
    if (!(std::abs(target_udeg) < 1e15))
      return tl::unexpected(error(Kind::refused, operation, "the angle is no position the axis can count to"));
    if (angle_rad < limits.lowest_rad || angle_rad > limits.highest_rad) {
      const bool low = angle_rad < limits.lowest_rad;
      return tl::unexpected(error(Kind::refused, operation,
                                  "the target is " +
                                      std::string(low ? "below the soft limit of " : "beyond the soft limit of ") +
                                      degrees(low ? limits.lowest_rad : limits.highest_rad),
                                  "stay between " + degrees(limits.lowest_rad) + " and " + degrees(limits.highest_rad) +
                                      ", home again where turns have added up, or set the limits wider"));
    }
    if (!(speed_udeg >= 1 && speed_udeg <= max_speed_udeg))
      return tl::unexpected(error(Kind::refused, operation,
                                  "a speed of " + degrees(speed_rad_per_s) + "/s is outside what the axis can do",
                                  "give more than 0 and at most " + degrees(capabilities.max_speed_rad_per_s) + "/s"));
    if (auto ready = require(operation, {MotionState::standstill}); !ready) return ready;
    return command(operation, protocol::kMove, static_cast<std::int64_t>(target_udeg),
                   static_cast<std::uint32_t>(speed_udeg), jerk_mdeg_per_s3());
  }

  // What a motion that ended in another state than standstill has to say.
  tl::expected<void, DeviceError> require_standstill(const std::string& operation) const {
    const MotionState state = last->status.motion;
    if (state == MotionState::standstill) return {};
    if (state == MotionState::unhomed)
      return tl::unexpected(error(Kind::wrong_state, operation, "it was stopped before it ended"));
    return tl::unexpected(fault_error(operation));
  }

  std::uint32_t jerk_mdeg_per_s3() const {
    return static_cast<std::uint32_t>(std::lround(limits.jerk_rad_per_s3 * kMdeg_per_rad));
  }

  // How much longer than a trapezoid an S-curve takes, at most.
  double rounding_s() const {
    if (limits.jerk_rad_per_s3 <= 0) return 0;
    return 2 * std::min(capabilities.max_acceleration_rad_per_s2 / limits.jerk_rad_per_s3,
                        std::sqrt(capabilities.max_speed_rad_per_s / limits.jerk_rad_per_s3));
  }

  double stopping_s() const { return capabilities.max_speed_rad_per_s / capabilities.max_acceleration_rad_per_s2; }

  SafeReport make_safe() {
    SafeReport report;
    if (last) {
      report.lasers_were_on = last->status.lasers_on;
      report.motion_was = last->status.motion;
    }
    bool commanded = write(reg::control::make_safe, 1).has_value();
    const double stop_s = capabilities.max_acceleration_rad_per_s2 > 0 ? stopping_s() : 10;
    const std::int64_t deadline_ns = now_ns() + nanoseconds(stop_s) + kStartLimit_ns;
    link_is_up = false;
    while (refresh()) {
      if (!commanded) commanded = write(reg::control::make_safe, 1).has_value();
      report.lasers_off = is_dark(*last);
      report.motor_stopped = is_standing(last->status);
      if ((report.lasers_off && report.motor_stopped) || now_ns() >= deadline_ns) break;
      link.clock().sleep_until(now_ns() + kPollPeriod_ns);
    }
    if (!link_is_up) report.lasers_off = report.motor_stopped = false;
    const bool was_busy = report.lasers_were_on != 0 || report.motion_was == MotionState::homing ||
                          report.motion_was == MotionState::moving || report.motion_was == MotionState::settling;
    report.text = std::string(was_busy ? "found it active" : "found it at rest") + " (" +
                  state_name(report.motion_was) + ", lasers " + (report.lasers_were_on ? "on" : "off") +
                  "); left it with " + state_left();
    const bool glued = link_is_up && last->lasers_enabled == 0 && last->status.lasers_on != 0;
    if (glued) report.text += "; a laser emits although it is switched off";
    if (link_is_up && !(report.lasers_off && report.motor_stopped))
      report.text += "; NOT SAFE: cut the power at the machine";
    return report;
  }
};

ScannerDevice::ScannerDevice(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

ScannerDevice::~ScannerDevice() {
  make_safe();
  if (impl_->link_is_up && impl_->link.token() != 0) (void)impl_->write(reg::control::session_end, impl_->link.token());
}

tl::expected<std::unique_ptr<ScannerDevice>, DeviceError> ScannerDevice::open(std::unique_ptr<Transport> transport,
                                                                              Clock& clock) {
  const std::string operation = "open";
  auto impl = std::make_unique<Impl>(std::move(transport), clock);
  auto identity = impl->link.read_identity();
  if (!identity) {
    DeviceError error = impl->failure(operation, std::move(identity.error()));
    if (error.kind == Kind::wrong_protocol) {
      error.left = "its state unknown and untouched";
      error.remedy = "check the address, or update the older of controller and program";
    }
    return tl::unexpected(std::move(error));
  }
  impl->identity = std::move(*identity);
  if (auto first = impl->refresh(); !first) return tl::unexpected(impl->failure(operation, std::move(first.error())));
  impl->found = impl->make_safe();
  auto capabilities = impl->link.read_capabilities();
  if (!capabilities) return tl::unexpected(impl->failure(operation, std::move(capabilities.error())));
  impl->capabilities = *capabilities;
  if (capabilities->laser_class < protocol::kClass1 || capabilities->laser_class > protocol::kClass3R) {
    const bool is_3b = capabilities->laser_class == protocol::kClass3B;
    return tl::unexpected(impl->error(
        Kind::refused, operation,
        is_3b ? "the controller declares laser class 3B"
              : "the controller declares the unknown laser class code " + std::to_string(capabilities->laser_class),
        "use a machine whose laser class is 1, 2 or 3R"));
  }
  if (!impl->link_is_up || !impl->found.lasers_off || !impl->found.motor_stopped)
    return tl::unexpected(impl->error(Kind::fault, operation, "it could not be made safe: " + impl->found.text,
                                      "cut the power at the machine"));
  if (auto taken = impl->take_machine(operation); !taken) return tl::unexpected(std::move(taken.error()));
  impl->presses = 0;
  impl->restarted = false;
  impl->jumped.reset();
  return std::unique_ptr<ScannerDevice>(new ScannerDevice(std::move(impl)));
}

const DeviceIdentity& ScannerDevice::identity() const {
  return impl_->identity;
}
const DeviceCapabilities& ScannerDevice::capabilities() const {
  return impl_->capabilities;
}
const SafeReport& ScannerDevice::found_at_open() const {
  return impl_->found;
}
const LinkQuality& ScannerDevice::link_quality() const {
  return impl_->link.quality();
}

tl::expected<DeviceStatus, DeviceError> ScannerDevice::poll() {
  if (auto polled = impl_->poll("poll"); !polled) return tl::unexpected(std::move(polled.error()));
  return impl_->last->status;
}

std::uint16_t ScannerDevice::take_button_presses() {
  return std::exchange(impl_->presses, std::uint16_t{0});
}

bool ScannerDevice::tells_changes() const {
  return impl_->link.tells_changes();
}

bool ScannerDevice::changed() {
  return impl_->link.changed();
}

std::size_t ScannerDevice::take_trace(std::span<TraceSample> samples) {
  return impl_->link.take_trace(samples);
}

tl::expected<void, DeviceError> ScannerDevice::set_motion_limits(const MotionLimits& limits) {
  Impl& d = *impl_;
  const std::string operation = "set the limits of motion";
  if (!(limits.lowest_rad < limits.highest_rad))
    return tl::unexpected(d.error(
        Kind::refused, operation,
        "the lower soft limit is " + degrees(limits.lowest_rad) + " and the upper " + degrees(limits.highest_rad),
        "give a lower one below the upper"));
  const double jerk_mdeg = std::round(limits.jerk_rad_per_s3 * kMdeg_per_rad);
  if (!(jerk_mdeg >= 0 && jerk_mdeg <= 4294967295.0) || (jerk_mdeg < 1 && limits.jerk_rad_per_s3 > 0))
    return tl::unexpected(d.error(Kind::refused, operation,
                                  "a jerk of " + degrees(limits.jerk_rad_per_s3) + "/s3 is none",
                                  "give 0 for trapezoids, or 0.001 to 4294967 deg/s3"));
  if (jerk_mdeg > 0 && !d.capabilities.takes_jerk)
    return tl::unexpected(d.error(Kind::refused, operation, "the controller moves by trapezoids only",
                                  "leave the jerk out, or update the controller to protocol 1.2"));
  d.limits = limits;
  return {};
}

double ScannerDevice::run_up_rad(double speed_rad_per_s) const {
  const double v = std::abs(speed_rad_per_s), a = impl_->capabilities.max_acceleration_rad_per_s2,
               j = impl_->limits.jerk_rad_per_s3;
  if (j <= 0) return v * v / (2 * a);
  return v * j >= a * a ? v * v / (2 * a) + v * a / (2 * j) : v * std::sqrt(v / j);
}

void ScannerDevice::set_interrupt(std::function<std::optional<std::string>()> interrupted) {
  impl_->interrupted = std::move(interrupted);
}

tl::expected<void, DeviceError> ScannerDevice::home() {
  const std::string operation = "home";
  Impl& d = *impl_;
  if (auto ready = d.require(operation, {MotionState::unhomed, MotionState::standstill, MotionState::stopped}); !ready)
    return ready;
  if (auto sent = d.command(operation, protocol::kHome); !sent) return sent;
  d.position_is_lost = false;
  return d.finish_motion(operation, kHomingLimit_ns);
}

tl::expected<DeviceStatus, DeviceError> ScannerDevice::rotate_to(double angle_rad, double speed_rad_per_s) {
  const std::string operation = "rotate to " + degrees(angle_rad);
  Impl& d = *impl_;
  if (auto sent = d.send_move(operation, angle_rad, speed_rad_per_s); !sent)
    return tl::unexpected(std::move(sent.error()));
  const double turn_s =
      std::abs(angle_rad - d.last->status.angle_rad) / speed_rad_per_s + d.stopping_s() + d.rounding_s();
  const std::int64_t limit_ns = nanoseconds(1.5 * turn_s + 5);
  if (auto ended = d.finish_motion(operation, limit_ns); !ended) return tl::unexpected(std::move(ended.error()));
  const double off_rad = d.last->status.angle_rad - angle_rad;
  if (std::abs(off_rad) > std::max(kOnTarget_rad, 4 * d.capabilities.encoder_resolution_rad))
    return tl::unexpected(d.error(
        Kind::fault, operation,
        "it stands " + degrees(off_rad) + " away from the target: the motor lost steps or the encoder its count",
        "check belt, motor current and encoder, or what else stopped it, then home again"));
  return d.last->status;
}

tl::expected<void, DeviceError> ScannerDevice::start_sweep(double angle_rad, double speed_rad_per_s) {
  const std::string operation = "sweep to " + degrees(angle_rad);
  Impl& d = *impl_;
  if (auto sent = d.send_move(operation, angle_rad, speed_rad_per_s); !sent) return sent;
  // A sweep of no length is over before it is seen moving; the controller takes the state `moving` with the command.
  if (auto moves = d.poll(operation); !moves) return moves;
  if (d.last->status.motion == MotionState::stopped || d.last->status.motion == MotionState::fault)
    return tl::unexpected(d.fault_error(operation));
  return {};
}

tl::expected<void, DeviceError> ScannerDevice::clear_fault() {
  Impl& d = *impl_;
  const std::string operation = "clear fault";
  if (auto polled = d.poll(operation); !polled) return polled;
  auto written = d.write(reg::control::clear_fault, 1);
  if (!written) return tl::unexpected(d.failure(operation, std::move(written.error())));
  return d.poll(operation);
}

tl::expected<void, DeviceError> ScannerDevice::stop() {
  const std::string operation = "stop";
  Impl& d = *impl_;
  if (auto sent = d.command(operation, protocol::kStop); !sent) return sent;
  return d.wait_until(operation, nanoseconds(d.stopping_s()) + kStartLimit_ns,
                      [&] { return is_standing(d.last->status); });
}

tl::expected<void, DeviceError> ScannerDevice::renew_laser(int laser, std::int64_t lease_ms) {
  const std::string operation = "turn laser " + std::to_string(laser) + " on";
  Impl& d = *impl_;
  if (laser < 0 || laser >= d.capabilities.lasers)
    return tl::unexpected(
        d.error(Kind::refused, operation, "the machine has lasers 0 to " + std::to_string(d.capabilities.lasers - 1)));
  if (lease_ms < 1 || lease_ms > d.capabilities.lease_ms)
    return tl::unexpected(d.error(Kind::refused, operation,
                                  "a lease of " + std::to_string(lease_ms) + " ms is not granted",
                                  "ask for 1 to " + std::to_string(d.capabilities.lease_ms) + " ms"));
  // Where the newest poll forbids it, a fresh one decides; the controller itself judges whatever is sent.
  if (d.laser_refusal() != Refusal::none) {
    if (auto polled = d.poll(operation); !polled) return polled;
    if (const Refusal reason = d.laser_refusal(); reason != Refusal::none)
      return tl::unexpected(d.refusal(operation, reason));
  }
  auto written = d.link.write_lease(laser, lease_ms);
  if (!written) return tl::unexpected(d.failure(operation, std::move(written.error())));
  return {};
}

tl::expected<void, DeviceError> ScannerDevice::laser_off() {
  const std::string operation = "turn the lasers off";
  Impl& d = *impl_;
  const std::array<std::uint16_t, protocol::kMaxLasers> off{};
  auto written =
      d.link.write(reg::control::laser_lease, 0, std::span(off).first(static_cast<std::size_t>(d.capabilities.lasers)));
  if (!written) return tl::unexpected(d.failure(operation, std::move(written.error())));
  auto dark = d.wait_until(operation, kDarkLimit_ns, [&] { return is_dark(*d.last); });
  if (!dark && dark.error().kind == Kind::timed_out && d.link_is_up)
    dark.error().remedy = "cut the power at the machine: a laser emits although it is switched off";
  return dark;
}

tl::expected<void, DeviceError> ScannerDevice::set_lamp(LampPattern pattern) {
  Impl& d = *impl_;
  auto written = d.write(reg::control::lamp_pattern, static_cast<std::uint16_t>(pattern));
  if (!written) return tl::unexpected(d.failure("set lamp", std::move(written.error())));
  return {};
}

SafeReport ScannerDevice::make_safe() noexcept {
  try {
    return impl_->make_safe();
  } catch (...) {
    // Out of memory, or a clock that gave up: the controller's lease and watchdog remain.
    return {};
  }
}

}  // namespace celadon
