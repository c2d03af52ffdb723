#include "tests/firmware_bridge/simulated_drives.h"

#include <algorithm>
#include <cmath>

namespace celadon::test {

using protocol::Area;
using protocol::Exception;

namespace {

constexpr auto kBusy = static_cast<Exception>(6);

std::int32_t pair_of(const std::uint16_t* words) {
  return static_cast<std::int32_t>(std::uint32_t{words[0]} << 16 | words[1]);
}
std::uint16_t word_of(std::int64_t value, bool high) {
  const auto bits = static_cast<std::uint32_t>(static_cast<std::int32_t>(value));
  return static_cast<std::uint16_t>(high ? bits >> 16 : bits & 0xFFFF);
}

}  // namespace

// ---- I/O ----

std::uint16_t IoModule::relays() const {
  const bool starved = watchdog_100ms != 0 && world_.time_us > fed_us_ + watchdog_100ms * std::uint64_t{100'000};
  return starved ? std::uint16_t{0} : outputs_;
}

Exception IoModule::read(Area area, std::uint16_t address, std::uint16_t count, std::uint16_t* words) {
  const std::lock_guard lock(world_.mutex);
  world_.time_us += DriveWorld::kRequest_us;
  for (std::uint16_t i = 0; i < count; ++i) {
    const int at = address + i;
    if (area == Area::holding && at == 0x1000) {
      words[i] = watchdog_100ms;
    } else if (area == Area::holding && at == 0) {
      words[i] = relays();
    } else if (area == Area::input && at == 0x20) {
      const bool emits = (relays() & 1) != 0 || laser_stuck;
      words[i] = static_cast<std::uint16_t>((interlock_closed ? 1 : 0) | (emergency_stop ? 0 : 2) | (button ? 4 : 0) |
                                            (emits ? 8 : 0));
    } else {
      return Exception::illegal_address;
    }
  }
  return Exception::none;
}

Exception IoModule::write(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) {
  const std::lock_guard lock(world_.mutex);
  world_.time_us += DriveWorld::kRequest_us;
  if (address != 0 || count != 1) return Exception::illegal_address;
  outputs_ = words[0];
  fed_us_ = world_.time_us;
  return Exception::none;
}

// ---- motor ----

void SimulatedMotor::settle_state() {
  if (!enabled() && now() < way_.end_us()) {
    way_ = Trapezoid{now(), way_.position(now())};  // without torque it stands by friction
    homing_ = false;
  }
  if (homing_ && now() >= way_.end_us()) {
    homing_ = false;
    homed_ = true;
    zero_ = way_.position(way_.end_us());
    way_ = Trapezoid{now(), zero_};
  }
}

bool SimulatedMotor::moving() {
  settle_state();
  return now() < way_.end_us();
}

double SimulatedMotor::position() {
  settle_state();
  return way_.position(now()) - zero_;
}

double SimulatedMotor::speed() {
  settle_state();
  return way_.speed(now());
}

bool SimulatedMotor::homed() {
  settle_state();
  return homed_;
}

void SimulatedMotor::begin_move(double target, double steps_per_s, double steps_per_s2) {
  if (!enabled() || alarm != 0 || dead) return;
  ++moves;
  last_target = target;
  last_speed = steps_per_s;
  last_acceleration = steps_per_s2;
  way_ = Trapezoid::to_target(now(), way_.position(now()), target + zero_, steps_per_s, steps_per_s2);
}

void SimulatedMotor::begin_homing() {
  if (!enabled() || alarm != 0 || dead) return;
  ++homings;
  homing_ = true;
  homed_ = false;
  const double from = way_.position(now());
  way_ = Trapezoid::to_target(now(), from, from + 5000, 2000, 20'000);
}

void SimulatedMotor::halt() {
  ++stops;
  settle_state();
  homing_ = false;
  if (now() < way_.end_us()) way_ = Trapezoid::to_rest(now(), way_.position(now()), way_.speed(now()), 50'000);
}

void SimulatedMotor::set_zero() {
  settle_state();
  zero_ = way_.position(now());
}

// ---- AZ ----

Exception AzDrive::read(Area area, std::uint16_t address, std::uint16_t count, std::uint16_t* words) {
  const std::lock_guard lock(world_.mutex);
  world_.time_us += DriveWorld::kRequest_us / 2;
  if (area != Area::holding) return Exception::illegal_function;
  for (int i = 0; i < count; ++i) {
    const int at = address + i;
    if (at == 0x7E) {
      words[i] = 0;
    } else if (at == 0x7F) {
      const bool ready = enabled() && !moving() && alarm == 0 && !dead;
      words[i] = static_cast<std::uint16_t>((homed() ? 1 << 4 : 0) | (ready ? 1 << 5 : 0) | (alarm != 0 ? 1 << 7 : 0) |
                                            (moving() ? 1 << 13 : 0) | (enabled() && !moving() ? 1 << 14 : 0));
    } else if (at == 0x80 || at == 0x81) {
      words[i] = word_of(alarm, at == 0x80);
    } else if (at == 0xCC || at == 0xCD) {
      words[i] = word_of(std::llround(position()), at == 0xCC);
    } else if (at == 0xCE || at == 0xCF) {
      words[i] = word_of(std::llround(speed() * 60 / 1000), at == 0xCE);
    } else if (at == 0xD0 || at == 0xD1) {
      words[i] = word_of(std::llround(speed()), at == 0xD0);
    } else if (at >= 0x58 && at < 0x68) {
      words[i] = direct_data[static_cast<std::size_t>(at - 0x58)];
    } else if (at == 0x7D) {
      words[i] = command_;
    } else {
      return Exception::illegal_address;
    }
  }
  world_.time_us += DriveWorld::kRequest_us / 2;
  return Exception::none;
}

Exception AzDrive::write(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) {
  const std::lock_guard lock(world_.mutex);
  world_.time_us += DriveWorld::kRequest_us;
  if (is_busy()) return kBusy;
  if (address == 0x7D && count == 1) {
    const auto rising = static_cast<std::uint16_t>(words[0] & ~command_);
    command_ = words[0];
    released_ = (command_ & 1 << 6) != 0;
    if (rising & 1 << 4) begin_homing();
    if (rising & 1 << 5) halt();
    if (rising & 1 << 7) alarm = 0;
    return Exception::none;
  }
  if (address != 0x58 || count != 16) return Exception::illegal_address;
  std::copy_n(words, 16, direct_data.begin());
  const std::int32_t type = pair_of(words + 2), trigger = pair_of(words + 14);
  if (type != 1 || trigger != 1 || pair_of(words + 12) != 1000) return Exception::illegal_value;
  begin_move(pair_of(words + 4), pair_of(words + 6), pair_of(words + 8));  // rates in 0.001 kHz/s
  return Exception::none;
}

// ---- CS2RS ----

Exception LeadshineDrive::read(Area area, std::uint16_t address, std::uint16_t count, std::uint16_t* words) {
  const std::lock_guard lock(world_.mutex);
  world_.time_us += DriveWorld::kRequest_us / 2;
  if (area != Area::holding) return Exception::illegal_function;
  for (int i = 0; i < count; ++i) {
    const int at = address + i;
    if (at == 0x1003) {
      words[i] = static_cast<std::uint16_t>((alarm != 0 ? 1 : 0) | (enabled() && !dead ? 2 : 0) | (moving() ? 4 : 0) |
                                            (!moving() ? 0x30 : 0) | (homed() ? 0x40 : 0));
    } else if (at == 0x000F) {
      words[i] = 0;
    } else if (at == 0x1014 || at == 0x1015) {
      words[i] = word_of(std::llround(position() * 65536 / kSteps), at == 0x1014);
    } else if (at == 0x1046 || at == 0x1047) {
      words[i] = word_of(std::llround(speed() * 60 / kSteps), at == 0x1046);
    } else if (at == 0x2203) {
      words[i] = static_cast<std::uint16_t>(alarm);
    } else if (at == 0x602C || at == 0x602D) {
      words[i] = word_of(std::llround(position()), at == 0x602C);
    } else if (at >= 0x6200 && at < 0x6208) {
      words[i] = pr0[static_cast<std::size_t>(at - 0x6200)];
    } else if (at == 0x6002) {
      words[i] = 0;
    } else {
      return Exception::illegal_address;
    }
  }
  world_.time_us += DriveWorld::kRequest_us / 2;
  return Exception::none;
}

Exception LeadshineDrive::write(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) {
  const std::lock_guard lock(world_.mutex);
  world_.time_us += DriveWorld::kRequest_us;
  if (is_busy()) return kBusy;
  if (address == 0x6002 && count == 1) {
    if (words[0] == 0x20) begin_homing();
    if (words[0] == 0x21) set_zero();
    if (words[0] == 0x40) halt();
    return Exception::none;
  }
  if (address == 0x1801 && count == 1 && words[0] == 0x1111) {
    alarm = 0;
    return Exception::none;
  }
  if (address != 0x6200 || count != 8) return Exception::illegal_address;
  std::copy_n(words, 8, pr0.begin());
  if (words[0] != 1 || words[7] != 0x10) return Exception::illegal_value;
  // A ramp of n ms to 1000 rpm is 1000 / 60 turns a second gained in n / 1000 seconds.
  const double rate = 1000.0 / 60 * kSteps / (words[4] * 1e-3);
  begin_move(pair_of(words + 1), words[3] * kSteps / 60, rate);
  return Exception::none;
}

}  // namespace celadon::test
