#pragma once
// The device protocol as data: every register, state, code and lamp pattern once. PROTOCOL.md explains them and a test
// holds both together. Freestanding: no heap, no operating system, no floating point.

#include <cstddef>
#include <cstdint>

// Values and names that both sides speak: X(name, value, meaning).
#define CELADON_MOTION_STATES(X)                                                                                 \
  X(unhomed, 0, "standing, position reference unknown")                                                          \
  X(homing, 1, "searching the index")                                                                            \
  X(standstill, 2, "homed, standing and settled")                                                                \
  X(moving, 3, "on the way to the target, or decelerating after a stop")                                         \
  X(settling, 4, "target reached, vibration dying out")                                                          \
  X(stopped, 5, "stopped by heartbeat loss, interlock or emergency stop; may still decelerate until speed is 0") \
  X(fault, 6, "a fault of motor, encoder, laser or controller; lasers off, motor without torque or stopped")

#define CELADON_LAMP_PATTERNS(X)                         \
  X(off, 0, "dark")                                      \
  X(ready, 1, "steady")                                  \
  X(busy, 2, "on 0.8 s, off 0.2 s")                      \
  X(done, 3, "on 0.1 s, off 0.1 s, on 0.1 s, off 1.7 s") \
  X(attention, 4, "on 0.5 s, off 0.5 s")                 \
  X(fault, 5, "on 0.1 s, off 0.1 s")                     \
  X(warning, 6, "on 0.25 s, off 0.25 s")

#define CELADON_FAULT_CODES(X)                                                             \
  X(none, 0, "no fault")                                                                   \
  X(heartbeat_lost, 1, "the host fell silent while the machine moved or a laser was on")   \
  X(interlock_opened, 2, "the interlock opened while the machine moved or a laser was on") \
  X(emergency_stop, 3, "the emergency stop was pressed")                                   \
  X(motor_stalled, 16, "the motor stalled")                                                \
  X(encoder_fault, 17, "the encoder contradicts the motor or does not answer")             \
  X(homing_failed, 18, "the index was not found")                                          \
  X(travel_limit, 19, "an axis ran into its end of travel")                                \
  X(motor_overheated, 20, "the motor or its drive is too hot")                             \
  X(drive_fault, 21, "the motor drive reports a fault of its own")                         \
  X(laser_stuck_on, 32, "a laser emits although it is switched off")                       \
  X(laser_driver_fault, 33, "the laser driver reports a fault")                            \
  X(controller_fault, 48, "the controller failed its own check")

#define CELADON_REFUSALS(X)                                                         \
  X(none, 0, "nothing was refused")                                                 \
  X(unhomed, 1, "the axis is not homed")                                            \
  X(moving, 2, "the axis is still moving")                                          \
  X(stopped, 3, "the axis was stopped and not yet released by home or clear_fault") \
  X(fault, 4, "the machine is in a fault state")                                    \
  X(interlock_open, 5, "the interlock is open")                                     \
  X(emergency_stop, 6, "the emergency stop is pressed")                             \
  X(local_action_needed, 7, "a press of the button on the machine is needed first") \
  X(beyond_travel, 8, "the target lies beyond the axis's travel")                   \
  X(cause_persists, 9, "the cause of the fault is still there")                     \
  X(session_held, 10, "another host holds the machine")

// X(group, name, offset in the group, type, count, unit). 32- and 64-bit values: high word first. Text: two characters
// a word, the first in the high byte, zero padded.
#define CELADON_REGISTERS(X)                                    \
  X(status, heartbeat_left, 0, u16, 1, "ms")                    \
  X(status, boot_id, 1, u16, 1, "")                             \
  X(status, uptime, 2, u64, 1, "us")                            \
  X(status, flags, 6, u16, 1, "bits")                           \
  X(status, fault_code, 7, u16, 1, "code")                      \
  X(status, fault_detail, 8, u16, 1, "")                        \
  X(status, refusal, 9, u16, 1, "code")                         \
  X(status, button_presses, 10, u16, 1, "count")                \
  X(status, button_held, 11, u16, 1, "ms")                      \
  X(status, lamp, 12, u16, 1, "code")                           \
  X(status, lasers_measured, 13, u16, 1, "bits")                \
  X(status, lasers_enabled, 14, u16, 1, "bits")                 \
  X(status, lease_left, 15, u16, 4, "ms")                       \
  X(status, lease_expiries, 19, u16, 1, "count")                \
  X(status, fault_axis, 20, u16, 1, "")                         \
  X(axis_status, position_time, 0, u64, 1, "us")                \
  X(axis_status, position_counter, 4, u32, 1, "count")          \
  X(axis_status, angle, 6, s32, 1, "udeg")                      \
  X(axis_status, turns, 8, s32, 1, "turns")                     \
  X(axis_status, speed, 10, s32, 1, "udeg/s")                   \
  X(axis_status, target_angle, 12, s32, 1, "udeg")              \
  X(axis_status, target_turns, 14, s32, 1, "turns")             \
  X(axis_status, motion_state, 16, u16, 1, "code")              \
  X(axis_status, axis_flags, 17, u16, 1, "bits")                \
  X(axis_status, command_sequence, 18, u16, 1, "count")         \
  X(identity, magic, 0, u32, 1, "")                             \
  X(identity, protocol_major, 2, u16, 1, "")                    \
  X(identity, protocol_minor, 3, u16, 1, "")                    \
  X(identity, firmware_version, 4, u16, 1, "")                  \
  X(identity, machine_kind, 5, u16, 1, "bits")                  \
  X(identity, status_words, 6, u16, 1, "words")                 \
  X(identity, vendor, 8, text, 16, "")                          \
  X(identity, model, 24, text, 16, "")                          \
  X(identity, serial, 40, text, 16, "")                         \
  X(capabilities, axes, 0, u16, 1, "count")                     \
  X(capabilities, lasers, 1, u16, 1, "count")                   \
  X(capabilities, laser_class, 2, u16, 1, "code")               \
  X(capabilities, lease_max, 3, u16, 1, "ms")                   \
  X(capabilities, heartbeat_timeout, 4, u16, 1, "ms")           \
  X(capabilities, safety_hardware, 5, u16, 1, "bits")           \
  X(capabilities, session_timeout, 6, u16, 1, "ms")             \
  X(axis_capabilities, kind, 0, u16, 1, "code")                 \
  X(axis_capabilities, features, 1, u16, 1, "bits")             \
  X(axis_capabilities, travel_min, 2, s32, 1, "udeg")           \
  X(axis_capabilities, travel_max, 4, s32, 1, "udeg")           \
  X(axis_capabilities, encoder_resolution, 6, u32, 1, "ndeg")   \
  X(axis_capabilities, max_speed, 8, u32, 1, "udeg/s")          \
  X(axis_capabilities, max_acceleration, 10, u32, 1, "udeg/s2") \
  X(control, make_safe, 0, u16, 1, "command")                   \
  X(control, clear_fault, 1, u16, 1, "command")                 \
  X(control, lamp_pattern, 2, u16, 1, "code")                   \
  X(control, session, 3, u16, 1, "")                            \
  X(control, session_end, 4, u16, 1, "")                        \
  X(control, lease_session, 7, u16, 1, "")                      \
  X(control, laser_lease, 8, u16, 4, "ms")                      \
  X(axis_command, goal_angle, 0, s32, 1, "udeg")                \
  X(axis_command, goal_turns, 2, s32, 1, "turns")               \
  X(axis_command, goal_speed, 4, u32, 1, "udeg/s")              \
  X(axis_command, goal_acceleration, 6, u32, 1, "udeg/s2")      \
  X(axis_command, sequence, 8, u16, 1, "count")                 \
  X(axis_command, command, 9, u16, 1, "command")                \
  X(axis_command, session, 10, u16, 1, "")                      \
  X(axis_command, goal_jerk, 11, u32, 1, "mdeg/s3")

namespace celadon {

#define CELADON_ENUMERATOR(name, value, meaning) name = (value),
/// What an axis does; transitions in PROTOCOL.md.
enum class MotionState : std::uint16_t { CELADON_MOTION_STATES(CELADON_ENUMERATOR) };
enum class LampPattern : std::uint16_t { CELADON_LAMP_PATTERNS(CELADON_ENUMERATOR) };
/// Below 16: a forced stop. From 16 on: a fault that needs clear_fault.
enum class FaultCode : std::uint16_t { CELADON_FAULT_CODES(CELADON_ENUMERATOR) };
/// Why the last command was answered with exception 4.
enum class Refusal : std::uint16_t { CELADON_REFUSALS(CELADON_ENUMERATOR) };
#undef CELADON_ENUMERATOR

namespace protocol {

inline constexpr std::uint16_t kMajor = 1, kMinor = 3;
inline constexpr std::uint32_t kMagic = 0x43454C41;  ///< "CELA"
inline constexpr int kMaxAxes = 3, kMaxLasers = 4;
inline constexpr std::int64_t kTurn_udeg = 360'000'000;
inline constexpr std::uint16_t kTextWords = 16;

/// A code, its name and its meaning, as PROTOCOL.md prints them.
struct Code {
  std::uint16_t value;
  const char* name;
  const char* meaning;
};
#define CELADON_CODE(name, value, meaning) Code{value, #name, meaning},
inline constexpr Code kMotionStates[] = {CELADON_MOTION_STATES(CELADON_CODE)};
inline constexpr Code kLampPatterns[] = {CELADON_LAMP_PATTERNS(CELADON_CODE)};
inline constexpr Code kFaultCodes[] = {CELADON_FAULT_CODES(CELADON_CODE)};
inline constexpr Code kRefusals[] = {CELADON_REFUSALS(CELADON_CODE)};
#undef CELADON_CODE

/// The row of `table` with that value, or a row that says the code is unknown (a later minor version may add codes).
template <std::size_t N>
constexpr Code find_code(const Code (&table)[N], std::uint16_t value) {
  for (const Code& code : table) {
    if (code.value == value) return code;
  }
  return {value, "unknown", "a code this version does not know"};
}

// Bits of status.flags.
inline constexpr std::uint16_t kInterlockClosed = 1, kEmergencyStop = 2, kButtonDown = 4, kLocalActionNeeded = 8,
                               kHostAlive = 16, kSessionHeld = 32, kRemoteEnabled = 64;
// Bits of axis_status.axis_flags.
inline constexpr std::uint16_t kHomed = 1;
// Bits of identity.machine_kind.
inline constexpr std::uint16_t kSimulated = 1;
// Bits of capabilities.safety_hardware.
inline constexpr std::uint16_t kHasWatchdog = 1, kHasInterlock = 2, kHasEmergencyStop = 4, kHasKeySwitch = 8,
                               kHasRemoteInterlock = 16, kHasEmissionIndicator = 32, kHasRemoteEnable = 64;
// Bits of axis_capabilities.features.
inline constexpr std::uint16_t kEndless = 1, kHasIndex = 2, kClosedLoop = 4, kStampedByHost = 8, kTakesJerk = 16;
// Values of capabilities.laser_class.
inline constexpr std::uint16_t kClass1 = 1, kClass2 = 2, kClass3R = 3, kClass3B = 4;
// Values of axis_capabilities.kind; further kinds come with minor versions. A lift counts in micrometres where the
// others count in microdegrees.
inline constexpr std::uint16_t kTurntable = 1, kElevation = 2, kLift = 3;
// Values of axis_command.command.
inline constexpr std::uint16_t kNoCommand = 0, kHome = 1, kMove = 2, kStop = 3;

// In a write of lease_session and laser_lease: this laser stays as it is.
inline constexpr std::uint16_t kLeaseUnchanged = 0xFFFF;
// The first minor version that has sessions.
inline constexpr std::uint16_t kSessionMinor = 1;

/// Modbus exception codes the controller answers with; none means a normal reply.
enum class Exception : std::uint8_t {
  none = 0,
  illegal_function = 1,
  illegal_address = 2,
  illegal_value = 3,
  refused = 4
};

enum class Area : std::uint8_t { input, holding };
enum class Type : std::uint8_t { u16, u32, s32, u64, text };

/// A run of registers that repeats `repeats` times, once an axis, `words` apart.
struct Group {
  const char* name;
  Area area;
  std::uint16_t base, words, repeats;
  constexpr std::uint16_t address(int instance = 0) const {
    return static_cast<std::uint16_t>(base + instance * words);
  }
};

namespace groups {
inline constexpr Group status{"status", Area::input, 0x0000, 24, 1};
inline constexpr Group axis_status{"axis_status", Area::input, 0x0018, 24, kMaxAxes};
inline constexpr Group identity{"identity", Area::input, 0x0100, 64, 1};
inline constexpr Group capabilities{"capabilities", Area::input, 0x0140, 16, 1};
inline constexpr Group axis_capabilities{"axis_capabilities", Area::input, 0x0150, 16, kMaxAxes};
inline constexpr Group control{"control", Area::holding, 0x0000, 16, 1};
inline constexpr Group axis_command{"axis_command", Area::holding, 0x0020, 16, kMaxAxes};
}  // namespace groups

inline constexpr Group kGroups[] = {groups::status,       groups::axis_status,       groups::identity,
                                    groups::capabilities, groups::axis_capabilities, groups::control,
                                    groups::axis_command};

struct Register {
  Group group;
  const char* name;
  std::uint16_t offset;  ///< in words from the start of its group
  Type type;
  std::uint16_t count;
  const char* unit;
  constexpr std::uint16_t value_words() const {
    return type == Type::u64 ? 4 : type == Type::u32 || type == Type::s32 ? 2 : 1;
  }
  constexpr std::uint16_t words() const { return static_cast<std::uint16_t>(value_words() * count); }
  constexpr std::uint16_t address(int instance = 0) const {
    return static_cast<std::uint16_t>(group.address(instance) + offset);
  }
};

// Each register by its name: protocol::reg::status::uptime.
#define CELADON_REGISTER(group_, name_, offset_, type_, count_, unit_)                          \
  namespace reg::group_ {                                                                       \
  inline constexpr Register name_{groups::group_, #name_, offset_, Type::type_, count_, unit_}; \
  }
CELADON_REGISTERS(CELADON_REGISTER)
#undef CELADON_REGISTER
#define CELADON_REGISTER(group_, name_, offset_, type_, count_, unit_) reg::group_::name_,
inline constexpr Register kRegisters[] = {CELADON_REGISTERS(CELADON_REGISTER)};
#undef CELADON_REGISTER

/// True if no register overlaps another or leaves its group, and no group another.
constexpr bool registers_are_sound() {
  for (const Register& a : kRegisters) {
    if (a.offset + a.words() > a.group.words) return false;
    for (const Register& b : kRegisters) {
      if (a.group.area == b.group.area && a.address() < b.address() && a.address() + a.words() > b.address())
        return false;
    }
  }
  for (const Group& a : kGroups) {
    for (const Group& b : kGroups) {
      if (a.area == b.area && a.base < b.base && a.base + a.words * a.repeats > b.base) return false;
    }
  }
  return true;
}
static_assert(registers_are_sound());

/// Words of the one block that a poll reads, starting at address 0.
constexpr std::uint16_t status_words(int axes) {
  return static_cast<std::uint16_t>(groups::status.words + axes * groups::axis_status.words);
}
static_assert(status_words(kMaxAxes) <= 125, "one poll is one Modbus read");

constexpr std::uint32_t get_u32(const std::uint16_t* words) {
  return (std::uint32_t{words[0]} << 16) | words[1];
}
constexpr std::int32_t get_s32(const std::uint16_t* words) {
  return static_cast<std::int32_t>(get_u32(words));
}
constexpr std::uint64_t get_u64(const std::uint16_t* words) {
  return (std::uint64_t{get_u32(words)} << 32) | get_u32(words + 2);
}
constexpr void put_u32(std::uint16_t* words, std::uint32_t value) {
  words[0] = static_cast<std::uint16_t>(value >> 16);
  words[1] = static_cast<std::uint16_t>(value);
}
constexpr void put_s32(std::uint16_t* words, std::int32_t value) {
  put_u32(words, static_cast<std::uint32_t>(value));
}
constexpr void put_u64(std::uint16_t* words, std::uint64_t value) {
  put_u32(words, static_cast<std::uint32_t>(value >> 32));
  put_u32(words + 2, static_cast<std::uint32_t>(value));
}

/// A position over many turns is turns * 360 degrees + angle; any split of the sum is accepted.
constexpr std::int64_t join_turns(std::int32_t angle_udeg, std::int32_t turns) {
  return turns * kTurn_udeg + angle_udeg;
}
struct SplitAngle {
  std::int32_t angle_udeg;  ///< in [0, 360 000 000)
  std::int32_t turns;
};
/// The split the controller reports. @pre |position| below 2^31 turns.
constexpr SplitAngle split_turns(std::int64_t position_udeg) {
  std::int64_t turns = position_udeg / kTurn_udeg;
  if (position_udeg % kTurn_udeg < 0) --turns;
  return {static_cast<std::int32_t>(position_udeg - turns * kTurn_udeg), static_cast<std::int32_t>(turns)};
}

/// Whether the lamp is lit at a time of the controller's clock; the blink codes of PROTOCOL.md.
constexpr bool lamp_lit(LampPattern pattern, std::uint64_t now_us) {
  const std::uint64_t ms = now_us / 1000;
  switch (pattern) {
    case LampPattern::off:
      return false;
    case LampPattern::ready:
      return true;
    case LampPattern::busy:
      return ms % 1000 < 800;
    case LampPattern::done:
      return ms % 2000 < 100 || (ms % 2000 >= 200 && ms % 2000 < 300);
    case LampPattern::attention:
      return ms % 1000 < 500;
    case LampPattern::fault:
      return ms % 200 < 100;
    case LampPattern::warning:
      return ms % 500 < 250;
  }
  return false;
}

}  // namespace protocol
}  // namespace celadon
