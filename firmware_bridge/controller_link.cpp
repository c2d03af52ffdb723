#include "firmware_bridge/controller_link.h"

#include <algorithm>
#include <array>
#include <numbers>
#include <vector>

namespace celadon {
namespace {

using Kind = DeviceError::Kind;
using protocol::Register;
namespace reg = protocol::reg;
namespace groups = protocol::groups;

constexpr int kAttempts = 3, kAttemptsOfALostLink = 6;
constexpr std::int64_t kPause_ns = 20'000'000;  // before the second attempt; each later one doubles it
constexpr double kRad_per_udeg = std::numbers::pi / 180e6;

double radians(std::int64_t udeg) {
  return static_cast<double>(udeg) * kRad_per_udeg;
}

// rad of microdegrees, mm of micrometres.
double unit_of(std::uint16_t kind) {
  return kind == protocol::kLift ? 1e-3 : kRad_per_udeg;
}

AxisStatus decode_axis(const std::uint16_t* words, int block, std::uint16_t kind) {
  const auto at = [&](const Register& r) { return words + r.address(block); };
  const double unit = unit_of(kind);
  const auto position = [&](const Register& angle, const Register& turns) {
    return unit * static_cast<double>(protocol::join_turns(protocol::get_s32(at(angle)), protocol::get_s32(at(turns))));
  };
  AxisStatus axis;
  axis.motion = static_cast<MotionState>(*at(reg::axis_status::motion_state));
  axis.homed = *at(reg::axis_status::axis_flags) & protocol::kHomed;
  axis.position = position(reg::axis_status::angle, reg::axis_status::turns);
  axis.target = position(reg::axis_status::target_angle, reg::axis_status::target_turns);
  axis.speed = unit * protocol::get_s32(at(reg::axis_status::speed));
  axis.position_counter = protocol::get_u32(at(reg::axis_status::position_counter));
  axis.position_time_us = protocol::get_u64(at(reg::axis_status::position_time));
  return axis;
}

AxisLimits decode_limits(const std::uint16_t* block, std::uint16_t kind) {
  const auto at = [block](const Register& r) { return block + r.offset; };
  const double unit = unit_of(kind);
  AxisLimits limits;
  if (!(*at(reg::axis_capabilities::features) & protocol::kEndless)) {
    limits.lowest = unit * protocol::get_s32(at(reg::axis_capabilities::travel_min));
    limits.highest = unit * protocol::get_s32(at(reg::axis_capabilities::travel_max));
  }
  limits.max_speed = unit * protocol::get_u32(at(reg::axis_capabilities::max_speed));
  limits.max_acceleration = unit * protocol::get_u32(at(reg::axis_capabilities::max_acceleration));
  limits.resolution = unit * 1e-3 * protocol::get_u32(at(reg::axis_capabilities::encoder_resolution));
  return limits;
}

std::string text_at(const std::uint16_t* words) {
  std::string text;
  for (int i = 0; i < 2 * protocol::kTextWords; ++i) {
    const int byte = i % 2 == 0 ? words[i / 2] >> 8 : words[i / 2] & 0xFF;
    if (byte == 0) break;
    // The text goes into file names, logs and STEP headers: nothing but printable ASCII leaves here.
    text += byte >= 0x20 && byte < 0x7F ? static_cast<char>(byte) : '?';
  }
  return text;
}

std::string version_text(int major, int minor) {
  return std::to_string(major) + "." + std::to_string(minor);
}

LinkError foreign(std::string cause) {
  return {Kind::wrong_protocol, 0, std::move(cause), false};
}

}  // namespace

double microunits(AxisKind kind) {
  return kind == AxisKind::lift ? 1e3 : 180e6 / std::numbers::pi;
}

StatusBlock decode_status(std::span<const std::uint16_t> words, const AxisKinds& kinds) {
  StatusBlock block;
  DeviceStatus& s = block.status;
  const std::uint16_t* w = words.data();
  const auto at = [w](const Register& r) { return w + r.address(); };
  const std::uint16_t flags = *at(reg::status::flags);
  s.interlock_closed = flags & protocol::kInterlockClosed;
  s.emergency_stop = flags & protocol::kEmergencyStop;
  s.button_down = flags & protocol::kButtonDown;
  s.local_action_needed = flags & protocol::kLocalActionNeeded;
  s.remote_enabled = flags & protocol::kRemoteEnabled;
  s.boot_id = *at(reg::status::boot_id);
  s.uptime_us = protocol::get_u64(at(reg::status::uptime));
  s.fault_code = *at(reg::status::fault_code);
  if (s.fault_code != 0) s.fault_text = protocol::find_code(protocol::kFaultCodes, s.fault_code).meaning;
  s.button_presses = *at(reg::status::button_presses);
  s.button_held_ms = *at(reg::status::button_held);
  s.lamp = static_cast<LampPattern>(*at(reg::status::lamp));
  s.lasers_on = *at(reg::status::lasers_measured);
  block.lasers_enabled = *at(reg::status::lasers_enabled);
  for (int i = 0; i < protocol::kMaxLasers; ++i)
    s.lease_left_ms = std::max<std::uint32_t>(s.lease_left_ms, at(reg::status::lease_left)[i]);
  block.refusal = static_cast<Refusal>(*at(reg::status::refusal));
  block.fault_axis = *at(reg::status::fault_axis);
  for (int i = 0; i < protocol::kMaxAxes && kinds[static_cast<std::size_t>(i)] != 0; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const AxisStatus axis = decode_axis(w, i, kinds[k]);
    block.axes = i + 1;
    block.motion[k] = axis.motion;
    block.command_sequence[k] = w[reg::axis_status::command_sequence.address(i)];
    if (i == 0) {
      s.motion = axis.motion;
      s.homed = axis.homed;
      s.angle_rad = axis.position;
      s.target_rad = axis.target;
      s.speed_rad_per_s = axis.speed;
      s.position_counter = axis.position_counter;
      s.position_time_us = axis.position_time_us;
    } else if (kinds[k] == protocol::kElevation) {
      s.elevation = axis;
    } else if (kinds[k] == protocol::kLift) {
      s.lift = axis;
    }
  }
  return block;
}

void ControllerLink::count(const tl::expected<void, LinkError>& result) {
  ++quality_.requests;
  const std::uint64_t connections = transport_->connections();
  quality_.reconnects = connections > 0 ? connections - 1 : 0;
  if (result) return;
  const Kind kind = result.error().kind;
  if (kind == Kind::timed_out) ++quality_.time_outs;
  if (kind == Kind::broken_reply) ++quality_.broken_replies;
  if (kind == Kind::refused) ++quality_.exceptions;
}

template <class Exchange>
tl::expected<void, LinkError> ControllerLink::with_retries(Exchange exchange) {
  for (int attempt = 1;; ++attempt) {
    auto result = exchange();
    count(result);
    if (result || !result.error().retry_may_help) return result;
    const bool lost = result.error().kind == Kind::lost || result.error().kind == Kind::not_found;
    if (attempt >= (lost ? kAttemptsOfALostLink : kAttempts)) return result;
    clock_.sleep_until(clock_.now_ns() + (kPause_ns << (attempt - 1)));
    ++quality_.retries;
    // A reconnection that fails shows again in the next exchange, which is the one reported.
    if (lost) (void)transport_->reconnect();
  }
}

void ControllerLink::wait_until(std::int64_t time_ns) {
  if (transport_->has_events()) {
    // Declared time does not pass here: only what has come already shortens the wait.
    if (transport_->wait_for_event(clock_.is_real() ? time_ns - clock_.now_ns() : 0)) return;
  }
  clock_.sleep_until(time_ns);
}

tl::expected<StatusBlock, LinkError> ControllerLink::read_status() {
  return read_status_from(groups::status.base);
}

tl::expected<StatusBlock, LinkError> ControllerLink::watch_status() {
  return read_status_from(reg::status::boot_id.address());
}

tl::expected<StatusBlock, LinkError> ControllerLink::read_status_from(std::uint16_t first) {
  std::array<std::uint16_t, protocol::status_words(protocol::kMaxAxes)> words{};
  const auto wanted = std::span(words).first(protocol::status_words(axes_)).subspan(first);
  std::int64_t before_ns = 0, after_ns = 0;
  auto done = with_retries([&] {
    before_ns = clock_.now_ns();
    auto read = transport_->read_inputs(first, wanted);
    after_ns = clock_.now_ns();
    return read;
  });
  if (!done) return tl::unexpected(std::move(done.error()));
  for (int i = 0; i < axes_; ++i) {
    const std::uint16_t state = words[reg::axis_status::motion_state.address(i)];
    if (state > static_cast<std::uint16_t>(MotionState::fault))
      return tl::unexpected(foreign("the controller reports the motion state " + std::to_string(state) +
                                    ", which protocol " + version_text(protocol::kMajor, protocol::kMinor) + " lacks"));
  }
  quality_.round_trip_ns = after_ns - before_ns;
  quality_.longest_round_trip_ns = std::max(quality_.longest_round_trip_ns, quality_.round_trip_ns);
  StatusBlock block = decode_status(words, kinds_);
  if (block.status.fault_code != 0) {
    const std::string text = transport_->fault_text(words[reg::status::fault_detail.address()]);
    if (!text.empty()) block.status.fault_text += " (" + text + ")";
    const std::uint16_t kind = block.fault_axis < protocol::kMaxAxes ? kinds_[block.fault_axis] : std::uint16_t{0};
    if (kind == protocol::kElevation || kind == protocol::kLift)
      block.status.fault_text += std::string(" (") + axis_name(static_cast<AxisKind>(kind)) + ")";
  }
  block.status.host_before_ns = before_ns;
  block.status.host_after_ns = after_ns;
  return block;
}

tl::expected<DeviceIdentity, LinkError> ControllerLink::read_identity() {
  std::array<std::uint16_t, groups::identity.words> words{};
  auto done = with_retries([&] { return transport_->read_inputs(groups::identity.base, words); });
  if (!done) {
    // Address or function unknown: whatever answers there is no controller of this kind.
    if (done.error().kind == Kind::refused && done.error().code <= 2)
      return tl::unexpected(foreign("what answers there has no Celadon identity registers: " + done.error().cause));
    return tl::unexpected(std::move(done.error()));
  }
  const std::uint32_t magic = protocol::get_u32(&words[reg::identity::magic.offset]);
  if (magic != protocol::kMagic)
    return tl::unexpected(foreign("what answers there is no Celadon controller: its identity begins with " +
                                  std::to_string(magic) + " instead of " + std::to_string(protocol::kMagic)));
  DeviceIdentity identity;
  identity.protocol_major = words[reg::identity::protocol_major.offset];
  identity.protocol_minor = words[reg::identity::protocol_minor.offset];
  identity.firmware_version = words[reg::identity::firmware_version.offset];
  identity.simulated = words[reg::identity::machine_kind.offset] & protocol::kSimulated;
  identity.machine = text_at(&words[reg::identity::vendor.offset]) + " " +
                     text_at(&words[reg::identity::model.offset]) + " " + text_at(&words[reg::identity::serial.offset]);
  if (identity.protocol_major != protocol::kMajor)
    return tl::unexpected(foreign("the controller speaks protocol " +
                                  version_text(identity.protocol_major, identity.protocol_minor) +
                                  ", this program speaks " + version_text(protocol::kMajor, protocol::kMinor)));
  return identity;
}

tl::expected<DeviceCapabilities, LinkError> ControllerLink::read_capabilities() {
  constexpr std::size_t kFirst = groups::capabilities.words + groups::axis_capabilities.words;
  std::array<std::uint16_t, kFirst> words{};
  auto done = with_retries([&] { return transport_->read_inputs(groups::capabilities.base, words); });
  if (!done) return tl::unexpected(std::move(done.error()));
  const auto at = [&words](const Register& r) { return &words[r.address() - groups::capabilities.base]; };
  DeviceCapabilities c;
  c.axes = *at(reg::capabilities::axes);
  c.lasers = *at(reg::capabilities::lasers);
  c.laser_class = *at(reg::capabilities::laser_class);
  c.lease_ms = *at(reg::capabilities::lease_max);
  c.heartbeat_timeout_ms = *at(reg::capabilities::heartbeat_timeout);
  c.host_watchdog = *at(reg::capabilities::safety_hardware) & protocol::kHasWatchdog;
  c.remote_enable_switch = *at(reg::capabilities::safety_hardware) & protocol::kHasRemoteEnable;
  c.session_timeout_ms = *at(reg::capabilities::session_timeout);
  c.endless_rotation = *at(reg::axis_capabilities::features) & protocol::kEndless;
  c.takes_jerk = *at(reg::axis_capabilities::features) & protocol::kTakesJerk;
  c.stamped_by_host = *at(reg::axis_capabilities::features) & protocol::kStampedByHost;
  if (!c.endless_rotation) {
    c.travel_min_rad = radians(protocol::get_s32(at(reg::axis_capabilities::travel_min)));
    c.travel_rad = radians(std::int64_t{protocol::get_s32(at(reg::axis_capabilities::travel_max))} -
                           protocol::get_s32(at(reg::axis_capabilities::travel_min)));
  }
  c.encoder_resolution_rad = radians(protocol::get_u32(at(reg::axis_capabilities::encoder_resolution))) / 1000;
  c.max_speed_rad_per_s = radians(protocol::get_u32(at(reg::axis_capabilities::max_speed)));
  c.max_acceleration_rad_per_s2 = radians(protocol::get_u32(at(reg::axis_capabilities::max_acceleration)));
  if (c.axes < 1 || c.axes > protocol::kMaxAxes || c.lasers < 1 || c.lasers > protocol::kMaxLasers || c.lease_ms < 1 ||
      c.max_speed_rad_per_s <= 0 || c.max_acceleration_rad_per_s2 <= 0)
    return tl::unexpected(foreign("the controller declares capabilities that cannot be: " + std::to_string(c.axes) +
                                  " axes, " + std::to_string(c.lasers) + " lasers, a lease of " +
                                  std::to_string(c.lease_ms) + " ms"));
  AxisKinds kinds{protocol::kTurntable};
  if (c.axes > 1) {
    std::vector<std::uint16_t> others(groups::axis_capabilities.words * static_cast<std::size_t>(c.axes - 1));
    done = with_retries([&] { return transport_->read_inputs(groups::axis_capabilities.address(1), others); });
    if (!done) return tl::unexpected(std::move(done.error()));
    for (int i = 1; i < c.axes; ++i) {
      const std::uint16_t* block = &others[groups::axis_capabilities.words * static_cast<std::size_t>(i - 1)];
      const std::uint16_t kind = block[reg::axis_capabilities::kind.offset];
      const AxisLimits limits = decode_limits(block, kind);
      std::optional<AxisLimits>* slot = kind == protocol::kElevation ? &c.elevation
                                        : kind == protocol::kLift    ? &c.lift
                                                                     : nullptr;
      kinds[static_cast<std::size_t>(i)] = kind;
      if (slot == nullptr && kind > protocol::kLift) continue;  // of a later minor version
      if (slot == nullptr || slot->has_value() || !(limits.lowest < limits.highest) || limits.max_speed <= 0 ||
          limits.max_acceleration <= 0)
        return tl::unexpected(foreign("the controller declares an axis " + std::to_string(i) + " of kind " +
                                      std::to_string(kind) +
                                      " that cannot be: one of each kind, each with travel, speed and acceleration"));
      *slot = limits;
    }
  }
  kinds_ = kinds;
  axes_ = c.axes;
  return c;
}

std::optional<int> ControllerLink::block_of(AxisKind kind) const {
  for (int i = 0; i < axes_; ++i) {
    if (kinds_[static_cast<std::size_t>(i)] == static_cast<std::uint16_t>(kind)) return i;
  }
  return std::nullopt;
}

tl::expected<void, LinkError> ControllerLink::write(const Register& r, int index,
                                                    std::span<const std::uint16_t> values) {
  const auto address = static_cast<std::uint16_t>(r.address() + index);
  return with_retries([&] { return transport_->write_holding(address, values); });
}

tl::expected<void, LinkError> ControllerLink::write_lease(int laser, std::int64_t lease_ms) {
  // With a token the write begins before the leases and leaves the lasers in between as they are.
  std::array<std::uint16_t, 1 + protocol::kMaxLasers> words{};
  words.fill(protocol::kLeaseUnchanged);
  words[0] = token_;
  const auto first = static_cast<std::size_t>(token_ != 0 ? 0 : 1 + laser);
  const auto count = static_cast<std::size_t>(laser) + 2 - first;
  const auto address = static_cast<std::uint16_t>(reg::control::lease_session.address() + static_cast<int>(first));
  const std::int64_t start_ns = clock_.now_ns();
  return with_retries([&]() -> tl::expected<void, LinkError> {
    const std::int64_t left_ms = lease_ms - (clock_.now_ns() - start_ns) / 1'000'000;
    if (left_ms < 1)
      return tl::unexpected(LinkError{Kind::timed_out, 0, "no complete reply before the lease was over", false});
    words[static_cast<std::size_t>(laser) + 1] = static_cast<std::uint16_t>(left_ms);
    return transport_->write_holding(address, std::span(words).subspan(first, count));
  });
}

tl::expected<void, LinkError> ControllerLink::write_axis_command(int block, std::uint16_t sequence,
                                                                 const AxisOrder& order) {
  std::array<std::uint16_t, reg::axis_command::goal_jerk.offset + 2> words{};
  const protocol::SplitAngle target = protocol::split_turns(order.target);
  protocol::put_s32(&words[reg::axis_command::goal_angle.offset], target.angle_udeg);
  protocol::put_s32(&words[reg::axis_command::goal_turns.offset], target.turns);
  protocol::put_u32(&words[reg::axis_command::goal_speed.offset], order.speed);
  words[reg::axis_command::sequence.offset] = sequence;
  words[reg::axis_command::command.offset] = order.command;
  words[reg::axis_command::session.offset] = token_;
  protocol::put_u32(&words[reg::axis_command::goal_jerk.offset], order.jerk);
  // A controller without sessions knows no token, one without bit 4 of `features` no jerk.
  const std::size_t count = order.jerk != 0 ? words.size()
                            : token_ != 0   ? reg::axis_command::session.offset + std::size_t{1}
                                            : reg::axis_command::session.offset;
  return with_retries(
      [&] { return transport_->write_holding(groups::axis_command.address(block), std::span(words).first(count)); });
}

}  // namespace celadon
