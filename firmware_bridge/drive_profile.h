#pragma once
// Drives and input/output devices of other makers, described by data: registers, units, states and actions.
// DRIVE_PROFILES.md is the grammar of the files; this is what is left of one when it was read.

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "firmware_bridge/protocol.h"

namespace celadon {

/// Which half of a 32-bit value has the lower address.
enum class WordOrder : std::uint8_t { high_first, low_first };

/// What one count of a register is, times its scale. Steps are the motor's.
enum class DriveUnit : std::uint8_t {
  none,            ///< bits, codes
  step,            ///< of the motor
  step_per_s,      ///< speed
  rpm,             ///< speed, of the motor's shaft
  step_per_s2,     ///< acceleration
  ms_per_1000rpm,  ///< acceleration as the time to 1000 rpm: a larger count is a slower start
  ms               ///< a time
};
/// Its name in the files: "step/s", "ms/1000rpm".
const char* unit_name(DriveUnit unit);

struct DriveRegister {
  std::string name;
  std::uint16_t address = 0;
  protocol::Area area = protocol::Area::holding;
  int words = 1;
  bool is_signed = false;
  DriveUnit unit = DriveUnit::none;
  double scale = 1;        ///< of a count, in the unit; above 0
  bool confirmed = false;  ///< by the source; what is not is shown, and used for nothing that moves or protects
  std::string source;      ///< manual, edition, page
};

/// Holds where (register & mask) == value.
struct DriveCondition {
  std::size_t reg = 0;  ///< index into the registers
  std::uint32_t mask = 0, value = 0;
};

/// One value that an action writes. Neighbours whose registers follow each other go out in one request.
struct DriveWrite {
  enum class What : std::uint8_t { constant, target, speed, acceleration };
  std::size_t reg = 0;
  What what = What::constant;
  std::int64_t constant = 0;
};
using DriveAction = std::vector<DriveWrite>;

struct DriveAlarm {
  std::uint32_t code = 0;
  std::string text;
  FaultCode fault = FaultCode::drive_fault;
};

struct DriveProfile {
  std::string name, vendor, model;
  WordOrder word_order = WordOrder::high_first;
  double steps_per_turn = 0;          ///< of the motor, as delivered
  bool closed_loop = false;           ///< the position is measured, not counted
  bool has_index = false;             ///< homing ends at a mark that is always the same
  int crc_exception = 0;              ///< with which it answers a damaged request; 0: not at all, as Modbus says
  std::vector<std::string> settings;  ///< what must be set with the maker's tool, one sentence each
  std::vector<DriveRegister> registers;
  std::vector<DriveAlarm> alarms;

  std::optional<std::size_t> host_watchdog;  ///< register of the time after which it stops by itself
  std::size_t position = 0, speed = 0, alarm = 0;
  DriveCondition fault, moving, homed;
  std::optional<DriveCondition> ready, enabled, in_position;
  DriveAction enable, release, reset;  ///< may be empty
  DriveAction home, move, stop;
  DriveAction mark;  ///< makes the place where it stands position 0; may be empty
};

/// A device whose outputs switch lasers and motor and fall by themselves when the host is silent.
struct IoProfile {
  std::string name;
  WordOrder word_order = WordOrder::high_first;
  std::vector<DriveRegister> registers;
  std::size_t outputs = 0;                   ///< register
  std::optional<std::size_t> host_watchdog;  ///< register of the time after which the outputs fall
  std::uint16_t laser_class = protocol::kClass2;
  std::vector<std::uint32_t> lasers;         ///< masks in the outputs, one a laser
  std::uint32_t motor_enable = 0, lamp = 0;  ///< masks in the outputs; 0: not wired
  DriveCondition interlock_closed, emergency_stop, button;
  std::vector<DriveCondition> laser_emits;  ///< one a laser, or none: then what is commanded counts
  std::optional<DriveCondition> remote_enabled;
};

/// The count that stands in the words. @pre words holds r.words registers
std::int64_t get_count(const DriveRegister& r, WordOrder order, std::span<const std::uint16_t> words);
/// @pre words holds r.words registers; the count is in range
void put_count(const DriveRegister& r, WordOrder order, std::int64_t count, std::span<std::uint16_t> words);
bool in_range(const DriveRegister& r, std::int64_t count);

/// In steps, steps/s, steps/s^2 or ms, as the unit says; none: the count itself.
double quantity_of(const DriveRegister& r, std::int64_t count, double steps_per_turn);
/// The nearest count; of an acceleration the nearest that is not faster; of a speed or acceleration at least the
/// slowest that moves. @returns nullopt if the register cannot hold it
std::optional<std::int64_t> count_of(const DriveRegister& r, double quantity, double steps_per_turn);

/// Reads of neighbouring registers in one request each, in order of address.
struct RegisterBlock {
  protocol::Area area = protocol::Area::holding;
  std::uint16_t address = 0;
  std::uint16_t words = 0;
  std::vector<std::size_t> registers;
};
std::vector<RegisterBlock> blocks_of(const std::vector<DriveRegister>& registers, std::vector<std::size_t> wanted);

/// Registers of a profile that a poll needs, each once.
std::vector<std::size_t> polled_registers(const DriveProfile& profile);
std::vector<std::size_t> polled_registers(const IoProfile& profile);

/// A register that motion depends on and that is not confirmed; nullptr: there is none.
const DriveRegister* unconfirmed_for_motion(const DriveProfile& profile);
const DriveRegister* unconfirmed_for_safety(const IoProfile& profile);

}  // namespace celadon
