#include "firmware_bridge/device_motion.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace celadon {
namespace {

using Kind = DeviceError::Kind;
namespace reg = protocol::reg;

constexpr std::int64_t kHomingLimit_ns = 120'000 * kMillisecond_ns;
constexpr std::int64_t kStartLimit_ns = 2'000 * kMillisecond_ns;
constexpr double kMdeg_per_rad = 180e3 / std::numbers::pi;
// Where a controller claims to stand on its target but is further away, steps were lost or someone else moved it.
constexpr double kOnTarget_rad = 0.05 * std::numbers::pi / 180, kOnTarget_mm = 0.05;
constexpr AxisKind kKinds[] = {AxisKind::turntable, AxisKind::elevation, AxisKind::lift};

std::string degrees(double rad) {
  return position_text(AxisKind::turntable, rad);
}

std::int64_t nanoseconds(double seconds) {
  return static_cast<std::int64_t>(std::min(seconds, 1e9) * 1e9);
}

}  // namespace

bool DeviceMotion::has(AxisKind kind) const {
  return kind == AxisKind::turntable || (kind == AxisKind::elevation && machine_.capabilities.elevation) ||
         (kind == AxisKind::lift && machine_.capabilities.lift);
}

AxisLimits DeviceMotion::limits_of(AxisKind kind) const {
  const DeviceCapabilities& c = machine_.capabilities;
  if (kind == AxisKind::elevation) return c.elevation.value();
  if (kind == AxisKind::lift) return c.lift.value();
  AxisLimits table;
  if (!c.endless_rotation) {
    table.lowest = c.travel_min_rad;
    table.highest = c.travel_min_rad + c.travel_rad;
  }
  table.lowest = std::max(table.lowest, limits.lowest_rad);
  table.highest = std::min(table.highest, limits.highest_rad);
  table.max_speed = c.max_speed_rad_per_s;
  table.max_acceleration = c.max_acceleration_rad_per_s2;
  table.resolution = c.encoder_resolution_rad;
  return table;
}

tl::expected<void, DeviceError> DeviceMotion::set_limits(const MotionLimits& wanted) {
  const std::string operation = "set the limits of motion";
  if (!(wanted.lowest_rad < wanted.highest_rad))
    return tl::unexpected(machine_.error(
        Kind::refused, operation,
        "the lower soft limit is " + degrees(wanted.lowest_rad) + " and the upper " + degrees(wanted.highest_rad),
        "give a lower one below the upper"));
  const double jerk_mdeg = std::round(wanted.jerk_rad_per_s3 * kMdeg_per_rad);
  if (!(jerk_mdeg >= 0 && jerk_mdeg <= 4294967295.0) || (jerk_mdeg < 1 && wanted.jerk_rad_per_s3 > 0))
    return tl::unexpected(machine_.error(Kind::refused, operation,
                                         "a jerk of " + degrees(wanted.jerk_rad_per_s3) + "/s3 is none",
                                         "give 0 for trapezoids, or 0.001 to 4294967 deg/s3"));
  if (jerk_mdeg > 0 && !machine_.capabilities.takes_jerk)
    return tl::unexpected(machine_.error(Kind::refused, operation, "the controller moves by trapezoids only",
                                         "leave the jerk out, or update the controller to protocol 1.2"));
  limits = wanted;
  return {};
}

double DeviceMotion::run_up_rad(double speed_rad_per_s) const {
  const double v = std::abs(speed_rad_per_s), a = machine_.capabilities.max_acceleration_rad_per_s2,
               j = limits.jerk_rad_per_s3;
  if (j <= 0) return v * v / (2 * a);
  return v * j >= a * a ? v * v / (2 * a) + v * a / (2 * j) : v * std::sqrt(v / j);
}

// How much longer than a trapezoid an S-curve takes, at most.
double DeviceMotion::rounding_s() const {
  if (limits.jerk_rad_per_s3 <= 0) return 0;
  return 2 * std::min(machine_.capabilities.max_acceleration_rad_per_s2 / limits.jerk_rad_per_s3,
                      std::sqrt(machine_.capabilities.max_speed_rad_per_s / limits.jerk_rad_per_s3));
}

double DeviceMotion::stopping_s(AxisKind kind) const {
  const AxisLimits of = limits_of(kind);
  return of.max_acceleration > 0 ? of.max_speed / of.max_acceleration : 10;  // as long as nothing is known of it
}

double DeviceMotion::longest_stopping_s() const {
  double longest = 0;
  for (const AxisKind kind : kKinds) {
    if (has(kind)) longest = std::max(longest, stopping_s(kind));
  }
  return longest;
}

// Polls, and refuses here what the state does not allow.
tl::expected<void, DeviceError> DeviceMotion::require(const std::string& operation, AxisKind kind,
                                                      std::initializer_list<MotionState> allowed) {
  if (!has(kind))
    return tl::unexpected(machine_.error(Kind::refused, operation,
                                         std::string("the machine has no axis of the kind ") + axis_name(kind),
                                         "use a machine that has one"));
  if (auto polled = machine_.poll(operation); !polled) return polled;
  const DeviceStatus& s = machine_.last->status;
  if (const Refusal reason = safety_refusal(s); reason != Refusal::none)
    return tl::unexpected(machine_.refusal(operation, reason));
  const MotionState state = now(kind).motion;
  if (std::find(allowed.begin(), allowed.end(), state) != allowed.end()) return {};
  if (state == MotionState::fault) return tl::unexpected(machine_.fault_error(operation));
  if (state == MotionState::stopped) return tl::unexpected(machine_.refusal(operation, Refusal::stopped));
  if (state == MotionState::unhomed) return tl::unexpected(machine_.refusal(operation, Refusal::unhomed));
  return tl::unexpected(machine_.refusal(operation, Refusal::moving));
}

// Waits for the end of a motion; one that fails or is interrupted is stopped.
tl::expected<void, DeviceError> DeviceMotion::finish_motion(const std::string& operation, AxisKind kind,
                                                            std::int64_t limit_ns) {
  std::optional<std::string> cut;
  auto ended = machine_.wait_until(operation, limit_ns, [&] {
    const bool moves = in_motion(now(kind).motion);
    if (moves && interrupted) cut = interrupted();
    return cut || !moves;
  });
  if (ended && !cut) return require_standstill(operation, kind);
  make_safe();
  if (cut) return tl::unexpected(machine_.error(Kind::interrupted, operation, *cut));
  ended.error().left = machine_.state_left();
  return ended;
}

// What a motion that ended in another state than standstill has to say.
tl::expected<void, DeviceError> DeviceMotion::require_standstill(const std::string& operation, AxisKind kind) const {
  const MotionState state = now(kind).motion;
  if (state == MotionState::standstill) return {};
  if (state == MotionState::unhomed)
    return tl::unexpected(machine_.error(Kind::wrong_state, operation, "it was stopped before it ended"));
  return tl::unexpected(machine_.fault_error(operation));
}

tl::expected<void, DeviceError> DeviceMotion::command(const std::string& operation, AxisKind kind,
                                                      const AxisOrder& order) {
  const int block = machine_.link.block_of(kind).value_or(0);
  auto sent = machine_.link.write_axis_command(block, machine_.next_sequence(block), order);
  if (!sent) return tl::unexpected(machine_.failure(operation, std::move(sent.error())));
  return {};
}

tl::expected<void, DeviceError> DeviceMotion::home(const std::string& operation, AxisKind kind) {
  if (auto ready = require(operation, kind, {MotionState::unhomed, MotionState::standstill, MotionState::stopped});
      !ready)
    return ready;
  if (auto sent = command(operation, kind, {.command = protocol::kHome}); !sent) return sent;
  machine_.forget_jump(machine_.link.block_of(kind).value_or(0));
  return finish_motion(operation, kind, kHomingLimit_ns);
}

tl::expected<void, DeviceError> DeviceMotion::send_rotation(const std::string& operation, double angle_rad,
                                                            double speed_rad_per_s) {
  const double kUdeg = microunits(AxisKind::turntable);
  const double target_udeg = std::round(angle_rad * kUdeg);
  const double speed_udeg = std::round(speed_rad_per_s * kUdeg);
  const double max_speed_udeg = std::round(machine_.capabilities.max_speed_rad_per_s * kUdeg);
  if (!(std::abs(target_udeg) < 1e15))
    return tl::unexpected(machine_.error(Kind::refused, operation, "the angle is no position the axis can count to"));
  if (angle_rad < limits.lowest_rad || angle_rad > limits.highest_rad) {
    const bool low = angle_rad < limits.lowest_rad;
    return tl::unexpected(
        machine_.error(Kind::refused, operation,
                       "the target is " + std::string(low ? "below the soft limit of " : "beyond the soft limit of ") +
                           degrees(low ? limits.lowest_rad : limits.highest_rad),
                       "stay between " + degrees(limits.lowest_rad) + " and " + degrees(limits.highest_rad) +
                           ", home again where turns have added up, or set the limits wider"));
  }
  if (!(speed_udeg >= 1 && speed_udeg <= max_speed_udeg))
    return tl::unexpected(machine_.error(
        Kind::refused, operation, "a speed of " + degrees(speed_rad_per_s) + "/s is outside what the axis can do",
        "give more than 0 and at most " + degrees(machine_.capabilities.max_speed_rad_per_s) + "/s"));
  if (auto ready = require(operation, AxisKind::turntable, {MotionState::standstill}); !ready) return ready;
  return command(operation, AxisKind::turntable,
                 {.command = protocol::kMove,
                  .target = static_cast<std::int64_t>(target_udeg),
                  .speed = static_cast<std::uint32_t>(speed_udeg),
                  .jerk = static_cast<std::uint32_t>(std::lround(limits.jerk_rad_per_s3 * kMdeg_per_rad))});
}

tl::expected<void, DeviceError> DeviceMotion::finish_move(const std::string& operation, AxisKind kind, double target,
                                                          double speed) {
  const double rounding = kind == AxisKind::turntable ? rounding_s() : 0;
  const double move_s = std::abs(target - now(kind).position) / speed + stopping_s(kind) + rounding;
  if (auto ended = finish_motion(operation, kind, nanoseconds(1.5 * move_s + 5)); !ended) return ended;
  const double off = now(kind).position - target;
  const double allowed = kind == AxisKind::lift ? kOnTarget_mm : kOnTarget_rad;
  if (std::abs(off) <= std::max(allowed, 4 * limits_of(kind).resolution)) return {};
  return tl::unexpected(machine_.error(
      Kind::fault, operation,
      "it stands " + position_text(kind, off) + " away from the target: the motor lost steps or the encoder its count",
      std::string("check ") + (kind == AxisKind::turntable ? "belt, " : "") +
          "motor current and encoder, or what else stopped it, then home again"));
}

tl::expected<void, DeviceError> DeviceMotion::rotate_to(const std::string& operation, double angle_rad,
                                                        double speed_rad_per_s) {
  if (auto sent = send_rotation(operation, angle_rad, speed_rad_per_s); !sent) return sent;
  return finish_move(operation, AxisKind::turntable, angle_rad, speed_rad_per_s);
}

tl::expected<void, DeviceError> DeviceMotion::start_sweep(const std::string& operation, double angle_rad,
                                                          double speed_rad_per_s) {
  if (auto sent = send_rotation(operation, angle_rad, speed_rad_per_s); !sent) return sent;
  // A sweep of no length is over before it is seen moving; the controller takes the state `moving` with the command.
  if (auto moves = machine_.poll(operation); !moves) return moves;
  const MotionState state = now(AxisKind::turntable).motion;
  if (state == MotionState::stopped || state == MotionState::fault)
    return tl::unexpected(machine_.fault_error(operation));
  return {};
}

tl::expected<void, DeviceError> DeviceMotion::move_axis(const std::string& operation, AxisKind kind, double position) {
  if (auto ready = require(operation, kind, {MotionState::standstill}); !ready) return ready;
  const AxisLimits of = limits_of(kind);
  const double units = microunits(kind), target = std::round(position * units);
  // In the controller's own units, so that the ends of the travel themselves can be reached.
  if (!(target >= std::round(of.lowest * units) && target <= std::round(of.highest * units)))
    return tl::unexpected(
        machine_.error(Kind::refused, operation, "the target lies beyond the axis's travel",
                       "stay between " + position_text(kind, of.lowest) + " and " + position_text(kind, of.highest)));
  const double speed = std::floor(of.max_speed * units * (1 + 1e-12));
  if (auto sent = command(operation, kind,
                          {.command = protocol::kMove,
                           .target = static_cast<std::int64_t>(target),
                           .speed = static_cast<std::uint32_t>(speed)});
      !sent)
    return sent;
  return finish_move(operation, kind, position, of.max_speed);
}

tl::expected<void, DeviceError> DeviceMotion::stop(const std::string& operation) {
  tl::expected<void, DeviceError> first;
  for (const AxisKind kind : kKinds) {
    if (!has(kind)) continue;
    auto sent = command(operation, kind, {.command = protocol::kStop});
    if (!sent && first) first = std::move(sent);  // the others are stopped all the same
  }
  if (!first) return first;
  return machine_.wait_until(operation, nanoseconds(longest_stopping_s()) + kStartLimit_ns,
                             [&] { return all_standing(*machine_.last); });
}

SafeReport DeviceMotion::make_safe() {
  SafeReport report;
  if (machine_.last) {
    report.lasers_were_on = machine_.last->status.lasers_on;
    report.motion_was = machine_.last->status.motion;
    for (const MotionState state : machine_.last->motion) {
      if (!in_motion(report.motion_was) && in_motion(state)) report.motion_was = state;
    }
  }
  bool commanded = machine_.write(reg::control::make_safe, 1).has_value();
  const std::int64_t deadline_ns = machine_.now_ns() + nanoseconds(longest_stopping_s()) + kStartLimit_ns;
  machine_.link_is_up = false;
  while (machine_.refresh()) {
    if (!commanded) commanded = machine_.write(reg::control::make_safe, 1).has_value();
    report.lasers_off = is_dark(*machine_.last);
    report.motor_stopped = all_standing(*machine_.last);
    if ((report.lasers_off && report.motor_stopped) || machine_.now_ns() >= deadline_ns) break;
    machine_.link.clock().sleep_until(machine_.now_ns() + kPollPeriod_ns);
  }
  const bool up = machine_.link_is_up;
  if (!up) report.lasers_off = report.motor_stopped = false;
  const bool was_busy = report.lasers_were_on != 0 || in_motion(report.motion_was);
  report.text = std::string(was_busy ? "found it active" : "found it at rest") + " (" + state_name(report.motion_was) +
                ", lasers " + (report.lasers_were_on ? "on" : "off") + "); left it with " + machine_.state_left();
  const bool glued = up && machine_.last->lasers_enabled == 0 && machine_.last->status.lasers_on != 0;
  if (glued) report.text += "; a laser emits although it is switched off";
  if (up && !(report.lasers_off && report.motor_stopped)) report.text += "; NOT SAFE: cut the power at the machine";
  return report;
}

}  // namespace celadon
