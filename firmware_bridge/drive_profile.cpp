#include "firmware_bridge/drive_profile.h"

#include <algorithm>
#include <cmath>
#include <tuple>

namespace celadon {
namespace {

constexpr std::size_t kLongestRead = 64;  // words; less than any drive here allows
constexpr double kSecondsPerMinute = 60;

struct Range {
  std::int64_t lowest, highest;
};
Range range_of(const DriveRegister& r) {
  const int bits = 16 * r.words;
  const std::int64_t half = std::int64_t{1} << (bits - 1);
  return r.is_signed ? Range{-half, half - 1} : Range{0, 2 * half - 1};
}

std::vector<std::size_t> each_once(std::vector<std::size_t> wanted) {
  std::sort(wanted.begin(), wanted.end());
  wanted.erase(std::unique(wanted.begin(), wanted.end()), wanted.end());
  return wanted;
}

const DriveRegister* first_unconfirmed(const std::vector<DriveRegister>& registers,
                                       const std::vector<std::size_t>& used) {
  for (const std::size_t i : used) {
    if (!registers[i].confirmed) return &registers[i];
  }
  return nullptr;
}

}  // namespace

const char* unit_name(DriveUnit unit) {
  constexpr std::array names = {"none", "step", "step/s", "rpm", "step/s2", "ms/1000rpm", "ms"};
  return names[static_cast<std::size_t>(unit)];
}

std::int64_t get_count(const DriveRegister& r, WordOrder order, std::span<const std::uint16_t> words) {
  if (r.words == 1) return r.is_signed ? std::int64_t{static_cast<std::int16_t>(words[0])} : std::int64_t{words[0]};
  const bool high_first = order == WordOrder::high_first;
  const std::array<std::uint16_t, 2> pair = {words[high_first ? 0 : 1], words[high_first ? 1 : 0]};
  return r.is_signed ? std::int64_t{protocol::get_s32(pair.data())} : std::int64_t{protocol::get_u32(pair.data())};
}

void put_count(const DriveRegister& r, WordOrder order, std::int64_t count, std::span<std::uint16_t> words) {
  const auto bits = static_cast<std::uint64_t>(count);
  const auto low = static_cast<std::uint16_t>(bits & 0xFFFF), high = static_cast<std::uint16_t>(bits >> 16 & 0xFFFF);
  if (r.words == 1) {
    words[0] = low;
    return;
  }
  words[0] = order == WordOrder::high_first ? high : low;
  words[1] = order == WordOrder::high_first ? low : high;
}

bool in_range(const DriveRegister& r, std::int64_t count) {
  const Range range = range_of(r);
  return count >= range.lowest && count <= range.highest;
}

double quantity_of(const DriveRegister& r, std::int64_t count, double steps_per_turn) {
  const double value = static_cast<double>(count) * r.scale;
  if (r.unit == DriveUnit::rpm) return value * steps_per_turn / kSecondsPerMinute;
  // 1000 rpm within `value` milliseconds.
  if (r.unit == DriveUnit::ms_per_1000rpm)
    return value > 0 ? 1000 * steps_per_turn / kSecondsPerMinute / (value * 1e-3) : 0;
  return value;
}

std::optional<std::int64_t> count_of(const DriveRegister& r, double quantity, double steps_per_turn) {
  double count = quantity / r.scale;
  if (r.unit == DriveUnit::rpm) count *= kSecondsPerMinute / steps_per_turn;
  if (r.unit == DriveUnit::ms_per_1000rpm) count = 1000 * steps_per_turn / kSecondsPerMinute / quantity * 1e3 / r.scale;
  // A whole count that a division left a trifle off is meant to be whole.
  constexpr double kTrifle = 1e-9;
  if (r.unit == DriveUnit::ms_per_1000rpm) {
    count = std::ceil(count * (1 - kTrifle));
  } else if (r.unit == DriveUnit::step_per_s2) {
    count = std::floor(count * (1 + kTrifle));
  } else {
    count = std::round(count);
  }
  const bool is_rate = r.unit == DriveUnit::step_per_s || r.unit == DriveUnit::rpm ||
                       r.unit == DriveUnit::step_per_s2 || r.unit == DriveUnit::ms_per_1000rpm;
  if (is_rate) count = std::max(count, 1.0);
  const Range range = range_of(r);
  if (!(count >= static_cast<double>(range.lowest) && count <= static_cast<double>(range.highest))) return std::nullopt;
  return static_cast<std::int64_t>(count);
}

std::vector<RegisterBlock> blocks_of(const std::vector<DriveRegister>& registers, std::vector<std::size_t> wanted) {
  const auto place = [&](std::size_t i) { return std::tuple(registers[i].area, registers[i].address, i); };
  std::sort(wanted.begin(), wanted.end(), [&](std::size_t a, std::size_t b) { return place(a) < place(b); });
  std::vector<RegisterBlock> blocks;
  for (const std::size_t i : wanted) {
    const DriveRegister& r = registers[i];
    const int end = r.address + r.words;
    const bool follows = !blocks.empty() && blocks.back().area == r.area &&
                         r.address <= blocks.back().address + blocks.back().words &&
                         static_cast<std::size_t>(end - blocks.back().address) <= kLongestRead;
    if (!follows) blocks.push_back({r.area, r.address, 0, {}});
    RegisterBlock& block = blocks.back();
    block.words = static_cast<std::uint16_t>(std::max<int>(block.words, end - block.address));
    block.registers.push_back(i);
  }
  return blocks;
}

std::vector<std::size_t> polled_registers(const DriveProfile& p) {
  std::vector<std::size_t> used = {p.position, p.speed, p.alarm, p.fault.reg, p.moving.reg, p.homed.reg};
  for (const auto& condition : {p.ready, p.enabled, p.in_position}) {
    if (condition) used.push_back(condition->reg);
  }
  return each_once(std::move(used));
}

std::vector<std::size_t> polled_registers(const IoProfile& p) {
  std::vector<std::size_t> used = {p.interlock_closed.reg, p.emergency_stop.reg, p.button.reg};
  for (const DriveCondition& condition : p.laser_emits) used.push_back(condition.reg);
  if (p.remote_enabled) used.push_back(p.remote_enabled->reg);
  return each_once(std::move(used));
}

const DriveRegister* unconfirmed_for_motion(const DriveProfile& p) {
  std::vector<std::size_t> used = polled_registers(p);
  for (const DriveAction* action : {&p.enable, &p.release, &p.reset, &p.home, &p.move, &p.stop, &p.mark}) {
    for (const DriveWrite& write : *action) used.push_back(write.reg);
  }
  return first_unconfirmed(p.registers, used);
}

const DriveRegister* unconfirmed_for_safety(const IoProfile& p) {
  std::vector<std::size_t> used = polled_registers(p);
  used.push_back(p.outputs);
  if (p.host_watchdog) used.push_back(*p.host_watchdog);
  return first_unconfirmed(p.registers, used);
}

}  // namespace celadon
