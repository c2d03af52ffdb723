#include "firmware_bridge/controller_core.h"

// The register file: reads compose the blocks from the state, writes become commands.

namespace celadon {

using protocol::Exception;
using protocol::Group;
using protocol::Register;
namespace reg = protocol::reg;
namespace groups = protocol::groups;

namespace {

constexpr std::uint16_t kMaxRead = 125, kMaxWrite = 123;  // of one Modbus request

void put_text(const char* text, std::uint16_t* words) {
  for (std::uint16_t i = 0; i < 2 * protocol::kTextWords && text[i] != 0; ++i) {
    const auto c = static_cast<unsigned>(static_cast<unsigned char>(text[i]));
    words[i / 2] = static_cast<std::uint16_t>(words[i / 2] | (i % 2 == 0 ? c << 8 : c));
  }
}

// Whether [first, first + count) of a group starts and ends where values do and holds no unnamed word.
bool covers_whole_values(const Group& group, int first, int count) {
  int word = first;
  while (word < first + count) {
    bool named = false;
    for (const Register& r : protocol::kRegisters) {
      if (r.group.area != group.area || r.group.base != group.base) continue;
      if (word < r.offset || word >= r.offset + r.words()) continue;
      if ((word - r.offset) % r.value_words() != 0 || word + r.value_words() > first + count) return false;
      word += r.value_words();
      named = true;
      break;
    }
    if (!named) return false;
  }
  return true;
}

}  // namespace

Exception ControllerCore::read_input(std::uint64_t now_us, std::uint16_t address, std::uint16_t count,
                                     std::uint16_t* words) {
  sense(now_us);
  if (count == 0 || count > kMaxRead) return Exception::illegal_value;
  std::uint16_t image[64];
  for (int done = 0; done < count;) {
    const int wanted = address + done;
    const Group* found = nullptr;
    int instance = 0;
    for (const Group& group : protocol::kGroups) {
      const int instances = group.repeats > 1 ? config_.axes : 1;
      if (group.area != protocol::Area::input || wanted < group.base || wanted >= group.base + group.words * instances)
        continue;
      found = &group;
      instance = (wanted - group.base) / group.words;
    }
    if (found == nullptr) return Exception::illegal_address;
    for (std::uint16_t& word : image) word = 0;
    if (found->base == groups::status.base) put_status(image);
    if (found->base == groups::axis_status.base) put_axis_status(instance, image);
    if (found->base == groups::identity.base) put_identity(image);
    if (found->base == groups::capabilities.base) put_capabilities(image);
    if (found->base == groups::axis_capabilities.base) put_axis_capabilities(instance, image);
    for (int i = wanted - found->address(instance); i < found->words && done < count; ++i) words[done++] = image[i];
  }
  if (address <= reg::status::heartbeat_left.address()) feed_heartbeat();
  show_lamp();
  return Exception::none;
}

Exception ControllerCore::read_holding(std::uint64_t now_us, std::uint16_t address, std::uint16_t count,
                                       std::uint16_t* words) {
  sense(now_us);
  if (count == 0 || count > kMaxRead) return Exception::illegal_value;
  std::uint16_t control[16] = {};
  put_control(control);
  for (int i = 0; i < count; ++i) {
    const int wanted = address + i;
    const int axis = (wanted - groups::axis_command.base) / groups::axis_command.words;
    if (wanted < groups::control.words) {
      words[i] = control[wanted];
    } else if (wanted >= groups::axis_command.base && axis < config_.axes) {
      words[i] = axes_[axis].command[(wanted - groups::axis_command.base) % groups::axis_command.words];
    } else {
      return Exception::illegal_address;
    }
  }
  return Exception::none;
}

Exception ControllerCore::write_holding(std::uint64_t now_us, std::uint16_t address, std::uint16_t count,
                                        const std::uint16_t* words) {
  sense(now_us);
  if (count == 0 || count > kMaxWrite) return Exception::illegal_value;
  Exception result = Exception::illegal_address;
  if (address < groups::control.words) {
    if (covers_whole_values(groups::control, address, count)) result = write_control(address, count, words);
  } else if (address >= groups::axis_command.base) {
    const int axis = (address - groups::axis_command.base) / groups::axis_command.words;
    const int offset = (address - groups::axis_command.base) % groups::axis_command.words;
    if (axis < config_.axes && covers_whole_values(groups::axis_command, offset, count))
      result = write_axis(axis, static_cast<std::uint16_t>(offset), count, words);
  }
  if (result == Exception::none) feed_heartbeat();
  show_lamp();
  return result;
}

Exception ControllerCore::write_control(std::uint16_t offset, std::uint16_t count, const std::uint16_t* words) {
  const int first_lease = reg::control::laser_lease.offset;
  if (offset >= first_lease) {
    if (offset - first_lease + count > config_.lasers) return Exception::illegal_address;
    return grant(offset - first_lease, count, words, 0);
  }
  if (offset == reg::control::lease_session.offset) {
    if (count < 2 || count - 1 > config_.lasers) return Exception::illegal_address;
    if (words[0] == 0) return Exception::illegal_value;
    return grant(0, count - 1, words + 1, words[0]);
  }
  if (count != 1) return Exception::illegal_address;
  if (offset == reg::control::lamp_pattern.offset) {
    if (words[0] > static_cast<std::uint16_t>(LampPattern::warning)) return Exception::illegal_value;
    host_lamp_ = static_cast<LampPattern>(words[0]);
    return Exception::none;
  }
  if (offset == reg::control::session.offset) return claim_session(words[0]);
  if (offset == reg::control::session_end.offset) return end_session(words[0]);
  if (words[0] != 1) return Exception::illegal_value;
  if (offset == reg::control::clear_fault.offset) return clear_fault();
  make_safe();
  return Exception::none;
}

Exception ControllerCore::write_axis(int index, std::uint16_t offset, std::uint16_t count, const std::uint16_t* words) {
  Axis& axis = axes_[index];
  std::uint16_t block[16];
  for (int i = 0; i < 16; ++i) block[i] = axis.command[i];
  for (int i = 0; i < count; ++i) block[offset + i] = words[i];
  if (offset + count > reg::axis_command::command.offset) {
    const std::uint16_t sequence = block[reg::axis_command::sequence.offset];
    if (sequence != 0 && sequence == axis.last_sequence) return Exception::none;  // a repeat whose reply got lost
    const Exception result = run_command(index, block);
    if (result != Exception::none) return result;
    axis.last_sequence = sequence;
  }
  // Of one write: the token is nobody else's to read, and a host that knows no jerk means none.
  block[reg::axis_command::session.offset] = 0;
  protocol::put_u32(block + reg::axis_command::goal_jerk.offset, 0);
  for (int i = 0; i < 16; ++i) axis.command[i] = block[i];
  return Exception::none;
}

// ---- register images ----

void ControllerCore::put_status(std::uint16_t* words) const {
  std::uint16_t flags = 0;
  const auto flag = [&flags](bool on, std::uint16_t mask) {
    if (on) flags = static_cast<std::uint16_t>(flags | mask);
  };
  flag(inputs_.interlock_closed, protocol::kInterlockClosed);
  flag(inputs_.emergency_stop, protocol::kEmergencyStop);
  flag(button_, protocol::kButtonDown);
  flag(locked_, protocol::kLocalActionNeeded);
  flag(host_alive_, protocol::kHostAlive);
  flag(session_ != 0, protocol::kSessionHeld);
  flag(inputs_.remote_enabled, protocol::kRemoteEnabled);
  words[reg::status::heartbeat_left.offset] = heartbeat_left_ms();
  words[reg::status::boot_id.offset] = boot_id_;
  protocol::put_u64(words + reg::status::uptime.offset, now_us_);
  words[reg::status::flags.offset] = flags;
  words[reg::status::fault_code.offset] = static_cast<std::uint16_t>(fault_);
  words[reg::status::fault_detail.offset] = fault_detail_;
  words[reg::status::refusal.offset] = static_cast<std::uint16_t>(refusal_);
  words[reg::status::button_presses.offset] = presses_;
  words[reg::status::button_held.offset] = button_held_ms_;
  words[reg::status::lamp.offset] = static_cast<std::uint16_t>(shown_lamp_);
  words[reg::status::lasers_measured.offset] = inputs_.lasers_measured;
  words[reg::status::lasers_enabled.offset] = enabled_;
  for (int i = 0; i < config_.lasers; ++i) words[reg::status::lease_left.offset + i] = lease_left_ms(i);
  words[reg::status::lease_expiries.offset] = lease_expiries_;
  words[reg::status::fault_axis.offset] = fault_axis_;
}

void ControllerCore::put_axis_status(int index, std::uint16_t* words) const {
  const Axis& axis = axes_[index];
  const protocol::SplitAngle actual = protocol::split_turns(axis.sample.position_udeg);
  const protocol::SplitAngle target = protocol::split_turns(axis.target_udeg);
  protocol::put_u64(words + reg::axis_status::position_time.offset, axis.sample.time_us);
  protocol::put_u32(words + reg::axis_status::position_counter.offset, axis.sample.counter);
  protocol::put_s32(words + reg::axis_status::angle.offset, actual.angle_udeg);
  protocol::put_s32(words + reg::axis_status::turns.offset, actual.turns);
  protocol::put_s32(words + reg::axis_status::speed.offset, axis.sample.speed_udeg_per_s);
  protocol::put_s32(words + reg::axis_status::target_angle.offset, target.angle_udeg);
  protocol::put_s32(words + reg::axis_status::target_turns.offset, target.turns);
  words[reg::axis_status::motion_state.offset] = static_cast<std::uint16_t>(axis.state);
  words[reg::axis_status::axis_flags.offset] = axis.homed ? protocol::kHomed : std::uint16_t{0};
  words[reg::axis_status::command_sequence.offset] = axis.last_sequence;
}

void ControllerCore::put_identity(std::uint16_t* words) const {
  protocol::put_u32(words + reg::identity::magic.offset, protocol::kMagic);
  words[reg::identity::protocol_major.offset] = config_.protocol_major;
  words[reg::identity::protocol_minor.offset] = config_.protocol_minor;
  words[reg::identity::firmware_version.offset] = config_.firmware_version;
  words[reg::identity::machine_kind.offset] = config_.simulated ? protocol::kSimulated : std::uint16_t{0};
  words[reg::identity::status_words.offset] = protocol::status_words(config_.axes);
  put_text(config_.vendor, words + reg::identity::vendor.offset);
  put_text(config_.model, words + reg::identity::model.offset);
  put_text(config_.serial, words + reg::identity::serial.offset);
}

void ControllerCore::put_capabilities(std::uint16_t* words) const {
  words[reg::capabilities::axes.offset] = config_.axes;
  words[reg::capabilities::lasers.offset] = config_.lasers;
  words[reg::capabilities::laser_class.offset] = config_.laser_class;
  words[reg::capabilities::lease_max.offset] = config_.lease_max_ms;
  words[reg::capabilities::heartbeat_timeout.offset] = config_.heartbeat_timeout_ms;
  words[reg::capabilities::safety_hardware.offset] = config_.safety_hardware;
  words[reg::capabilities::session_timeout.offset] = config_.session_timeout_ms;
}

void ControllerCore::put_axis_capabilities(int index, std::uint16_t* words) const {
  const ControllerConfig::Axis& axis = config_.axis[index];
  words[reg::axis_capabilities::kind.offset] = axis.kind;
  words[reg::axis_capabilities::features.offset] = axis.features;
  protocol::put_s32(words + reg::axis_capabilities::travel_min.offset, axis.travel_min_udeg);
  protocol::put_s32(words + reg::axis_capabilities::travel_max.offset, axis.travel_max_udeg);
  protocol::put_u32(words + reg::axis_capabilities::encoder_resolution.offset, axis.encoder_resolution_ndeg);
  protocol::put_u32(words + reg::axis_capabilities::max_speed.offset, axis.max_speed_udeg_per_s);
  protocol::put_u32(words + reg::axis_capabilities::max_acceleration.offset, axis.max_acceleration_udeg_per_s2);
}

void ControllerCore::put_control(std::uint16_t* words) const {
  words[reg::control::lamp_pattern.offset] = static_cast<std::uint16_t>(host_lamp_);
  words[reg::control::session.offset] = session_ != 0 ? 1 : 0;
  for (int i = 0; i < config_.lasers; ++i) words[reg::control::laser_lease.offset + i] = lease_left_ms(i);
}

}  // namespace celadon
