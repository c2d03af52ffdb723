#include "firmware_bridge/controller_link.h"

#include <algorithm>
#include <array>
#include <numbers>

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

StatusBlock decode_status(std::span<const std::uint16_t> words) {
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
  s.position_time_us = protocol::get_u64(at(reg::axis_status::position_time));
  s.position_counter = protocol::get_u32(at(reg::axis_status::position_counter));
  s.angle_rad = radians(protocol::join_turns(protocol::get_s32(at(reg::axis_status::angle)),
                                             protocol::get_s32(at(reg::axis_status::turns))));
  s.speed_rad_per_s = radians(protocol::get_s32(at(reg::axis_status::speed)));
  s.target_rad = radians(protocol::join_turns(protocol::get_s32(at(reg::axis_status::target_angle)),
                                              protocol::get_s32(at(reg::axis_status::target_turns))));
  s.motion = static_cast<MotionState>(*at(reg::axis_status::motion_state));
  s.homed = *at(reg::axis_status::axis_flags) & protocol::kHomed;
  block.command_sequence = *at(reg::axis_status::command_sequence);
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
  std::array<std::uint16_t, protocol::status_words(1)> words{};
  std::int64_t before_ns = 0, after_ns = 0;
  auto done = with_retries([&] {
    before_ns = clock_.now_ns();
    auto read = transport_->read_inputs(groups::status.base, words);
    after_ns = clock_.now_ns();
    return read;
  });
  if (!done) return tl::unexpected(std::move(done.error()));
  if (words[reg::axis_status::motion_state.address()] > static_cast<std::uint16_t>(MotionState::fault))
    return tl::unexpected(foreign("the controller reports the motion state " +
                                  std::to_string(words[reg::axis_status::motion_state.address()]) +
                                  ", which protocol " + version_text(protocol::kMajor, protocol::kMinor) + " lacks"));
  quality_.round_trip_ns = after_ns - before_ns;
  quality_.longest_round_trip_ns = std::max(quality_.longest_round_trip_ns, quality_.round_trip_ns);
  StatusBlock block = decode_status(words);
  if (block.status.fault_code != 0) {
    const std::string text = transport_->fault_text(words[reg::status::fault_detail.address()]);
    if (!text.empty()) block.status.fault_text += " (" + text + ")";
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
  std::array<std::uint16_t, groups::capabilities.words + groups::axis_capabilities.words> words{};
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
  if (!c.endless_rotation)
    c.travel_rad = radians(std::int64_t{protocol::get_s32(at(reg::axis_capabilities::travel_max))} -
                           protocol::get_s32(at(reg::axis_capabilities::travel_min)));
  c.encoder_resolution_rad = radians(protocol::get_u32(at(reg::axis_capabilities::encoder_resolution))) / 1000;
  c.max_speed_rad_per_s = radians(protocol::get_u32(at(reg::axis_capabilities::max_speed)));
  c.max_acceleration_rad_per_s2 = radians(protocol::get_u32(at(reg::axis_capabilities::max_acceleration)));
  if (c.axes < 1 || c.axes > protocol::kMaxAxes || c.lasers < 1 || c.lasers > protocol::kMaxLasers || c.lease_ms < 1 ||
      c.max_speed_rad_per_s <= 0 || c.max_acceleration_rad_per_s2 <= 0)
    return tl::unexpected(foreign("the controller declares capabilities that cannot be: " + std::to_string(c.axes) +
                                  " axes, " + std::to_string(c.lasers) + " lasers, a lease of " +
                                  std::to_string(c.lease_ms) + " ms"));
  return c;
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

tl::expected<void, LinkError> ControllerLink::write_axis_command(std::uint16_t command, std::uint16_t sequence,
                                                                 std::int64_t target_udeg,
                                                                 std::uint32_t speed_udeg_per_s,
                                                                 std::uint32_t jerk_mdeg_per_s3) {
  std::array<std::uint16_t, reg::axis_command::goal_jerk.offset + 2> words{};
  const protocol::SplitAngle target = protocol::split_turns(target_udeg);
  protocol::put_s32(&words[reg::axis_command::goal_angle.offset], target.angle_udeg);
  protocol::put_s32(&words[reg::axis_command::goal_turns.offset], target.turns);
  protocol::put_u32(&words[reg::axis_command::goal_speed.offset], speed_udeg_per_s);
  words[reg::axis_command::sequence.offset] = sequence;
  words[reg::axis_command::command.offset] = command;
  words[reg::axis_command::session.offset] = token_;
  protocol::put_u32(&words[reg::axis_command::goal_jerk.offset], jerk_mdeg_per_s3);
  // A controller without sessions knows no token, one without bit 4 of `features` no jerk.
  const std::size_t count = jerk_mdeg_per_s3 != 0 ? words.size()
                            : token_ != 0         ? reg::axis_command::session.offset + std::size_t{1}
                                                  : reg::axis_command::session.offset;
  return with_retries(
      [&] { return transport_->write_holding(groups::axis_command.base, std::span(words).first(count)); });
}

}  // namespace celadon
