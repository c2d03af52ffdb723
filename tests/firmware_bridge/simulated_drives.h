#pragma once
// Drives and an I/O device built from the makers' register maps by hand, not from the profiles: numbers here are the
// manuals' own. Motion is a closed formula of a device clock that moves with declared waits and with each request.

#include <array>
#include <cstdint>
#include <mutex>

#include "firmware_bridge/clock.h"
#include "tests/firmware_bridge/modbus_machine.h"

namespace celadon::test {

/// Time and the lock that everything simulated here shares.
class DriveWorld {
 public:
  static constexpr std::uint64_t kRequest_us = 1000;  // bus time of a request
  std::uint64_t now_us() {
    const std::lock_guard lock(mutex);
    return time_us;
  }
  void advance_ms(std::uint64_t ms) {
    const std::lock_guard lock(mutex);
    time_us += ms * 1000;
  }
  std::mutex mutex;
  std::uint64_t time_us = 0;
};

class WorldClock final : public Clock {
 public:
  explicit WorldClock(DriveWorld& world) : world_(world) {}
  std::int64_t now_ns() override { return static_cast<std::int64_t>(world_.now_us()) * 1000; }
  void sleep_until(std::int64_t time_ns) override {
    const std::lock_guard lock(world_.mutex);
    world_.time_us = std::max(world_.time_us, static_cast<std::uint64_t>((time_ns + 999) / 1000));
  }

 private:
  DriveWorld& world_;
};

/// Three relay outputs and four inputs behind a watchdog: holding register 0 (bit 0 laser, 1 motor enable, 2 lamp),
/// input register 0x20 (bit 0 interlock closed, 1 emergency stop released, 2 button, 3 laser emits), holding register
/// 0x1000 its watchdog in 100 ms.
class IoModule final : public Registers {
 public:
  explicit IoModule(DriveWorld& world) : world_(world) {}
  protocol::Exception read(protocol::Area area, std::uint16_t address, std::uint16_t count,
                           std::uint16_t* words) override;
  protocol::Exception write(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) override;

  /// As the relays stand: none after the watchdog's time without a write. Takes no lock.
  std::uint16_t relays() const;
  std::uint16_t relays_now() {
    const std::lock_guard lock(world_.mutex);
    return relays();
  }

  std::uint16_t watchdog_100ms = 5;
  bool interlock_closed = true, emergency_stop = false, button = false, laser_stuck = false;

 private:
  DriveWorld& world_;
  std::uint16_t outputs_ = 0;
  std::uint64_t fed_us_ = 0;
};

/// A motor in steps that moves along trapezoids while its enable relay is closed.
class SimulatedMotor {
 public:
  SimulatedMotor(DriveWorld& world, IoModule& io, double position) : world_(world), io_(io) { way_.from = position; }
  virtual ~SimulatedMotor() = default;

  // For tests, under the lock.
  double position_now() {
    const std::lock_guard lock(world_.mutex);
    return position();
  }
  double position_at(std::uint64_t time_us) {
    const std::lock_guard lock(world_.mutex);
    return way_.position(static_cast<double>(time_us)) - zero_;
  }

  double last_speed = 0, last_acceleration = 0, last_target = 0;  // of the last move, in steps
  int moves = 0, homings = 0, stops = 0;
  int alarm = 0;
  bool dead = false;    // never ready
  int busy_writes = 0;  // so many are answered "busy" and not done

 protected:
  bool is_busy() { return busy_writes > 0 && busy_writes-- > 0; }
  bool enabled() const { return (io_.relays() & 2) != 0 && !released_; }
  bool moving();
  double position();
  double speed();
  bool homed();
  void begin_move(double target, double steps_per_s, double steps_per_s2);
  void begin_homing();
  void halt();
  void set_zero();

  DriveWorld& world_;
  IoModule& io_;
  bool released_ = false;

 private:
  void settle_state();
  double now() const { return static_cast<double>(world_.time_us); }
  Trapezoid way_;
  double zero_ = 0;
  bool homing_ = false, homed_ = false;
};

/// AZ: 32-bit values, high word first; direct data operation, driver input command and output status.
class AzDrive final : public Registers, public SimulatedMotor {
 public:
  AzDrive(DriveWorld& world, IoModule& io) : SimulatedMotor(world, io, 1234) {}
  protocol::Exception read(protocol::Area area, std::uint16_t address, std::uint16_t count,
                           std::uint16_t* words) override;
  protocol::Exception write(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) override;

  std::array<std::uint16_t, 16> direct_data{};  // 0x0058 on, as last written in one request

 private:
  std::uint16_t command_ = 0;
};

/// CS2RS: 16-bit registers, pairs high word first; PR0 block that triggers by its last word.
class LeadshineDrive final : public Registers, public SimulatedMotor {
 public:
  LeadshineDrive(DriveWorld& world, IoModule& io) : SimulatedMotor(world, io, -777) {}
  protocol::Exception read(protocol::Area area, std::uint16_t address, std::uint16_t count,
                           std::uint16_t* words) override;
  protocol::Exception write(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) override;

  static constexpr double kSteps = 10000;  // a turn of the motor, Pr0.00
  std::array<std::uint16_t, 8> pr0{};      // 0x6200 on, as last written in one request
};

}  // namespace celadon::test
