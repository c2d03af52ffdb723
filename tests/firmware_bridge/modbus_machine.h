#pragma once
// A whole controller behind a real libmodbus server: core and closed-form plant on a device clock that moves with the
// host's declared waits and with the bus time of each request. The server thread and the test share it under one lock.

#include <modbus/modbus.h>

#include <atomic>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "firmware_bridge/clock.h"
#include "firmware_bridge/controller_core.h"
#include "tests/firmware_bridge/test_plant.h"

namespace celadon::test {

/// What a server serves; called by its thread.
class Registers {
 public:
  virtual ~Registers() = default;
  virtual protocol::Exception read(protocol::Area area, std::uint16_t address, std::uint16_t count,
                                   std::uint16_t* words) = 0;
  virtual protocol::Exception write(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) = 0;
};

class Machine final : public Registers {
 public:
  static constexpr std::uint64_t kRequest_us = 1000;  // bus time of a request

  explicit Machine(const ControllerConfig& config = test_config());

  void advance_to_us(std::uint64_t time_us);
  void advance_ms(std::uint64_t ms) { advance_to_us(now_us() + ms * 1000); }
  std::uint64_t now_us();
  void restart();  ///< power cut and power-up: a new core with another boot number; the clock begins at 0
  void press_button(std::uint64_t held_ms = 100);

  /// Runs `f(plant, core)` under the lock, then one step.
  template <class F>
  auto with(F f) {
    const std::lock_guard lock(mutex_);
    if constexpr (std::is_void_v<decltype(f(plant_, *core_))>) {
      f(plant_, *core_);
      core_->step(now_us_);
    } else {
      auto result = f(plant_, *core_);
      core_->step(now_us_);
      return result;
    }
  }

  // For the server: takes the bus time, then serves.
  protocol::Exception read(protocol::Area area, std::uint16_t address, std::uint16_t count,
                           std::uint16_t* words) override;
  protocol::Exception write(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) override;

  std::atomic<int> writes = 0, reads = 0;

 private:
  void advance_locked(std::uint64_t time_us);

  std::mutex mutex_;
  ControllerConfig config_;
  TestPlant plant_;
  std::uint64_t now_us_ = 0;
  std::uint16_t boot_id_ = 1;
  std::unique_ptr<ControllerCore> core_;
};

/// Waiting on it turns the machine's clock. Its zero is not the machine's.
class MachineClock final : public Clock {
 public:
  explicit MachineClock(Machine& machine) : machine_(machine) {}
  std::int64_t now_ns() override {
    const std::uint64_t device_us = machine_.now_us();
    if (device_us < seen_us_) past_us_ += seen_us_;  // the machine restarted; the host's time goes on
    seen_us_ = device_us;
    return kOffset_ns + static_cast<std::int64_t>((past_us_ + device_us) * 1000);
  }
  void sleep_until(std::int64_t time_ns) override {
    const std::int64_t wait_ns = time_ns - now_ns();
    if (wait_ns > 0) machine_.advance_to_us(seen_us_ + static_cast<std::uint64_t>(wait_ns + 999) / 1000);
  }

 private:
  static constexpr std::int64_t kOffset_ns = 5'000'000'000;
  Machine& machine_;
  std::uint64_t seen_us_ = 0, past_us_ = 0;
};

/// What the server does with a request instead of answering it properly.
enum class Mishap {
  none,
  drop,         ///< executed, no reply
  ignore,       ///< neither executed nor answered
  truncate,     ///< half a reply
  garble,       ///< bytes changed: CRC on RTU, transaction number on TCP
  wrong_count,  ///< a reply that carries fewer registers than it was asked for
  busy,         ///< exception 6
  bad_crc,      ///< exception 8, as drives answer that check the CRC and say so
  withhold,     ///< executed; the reply stays back until release_withheld()
  close_link    ///< executed, then the connection ends
};

class ModbusServer {
 public:
  enum class Link { tcp, rtu };
  ModbusServer(Registers& registers, Link link, int unit = 1);
  ~ModbusServer();
  ModbusServer(const ModbusServer&) = delete;
  ModbusServer& operator=(const ModbusServer&) = delete;

  std::string url(const std::string& options = "timeout_ms=2000") const;
  void mishap(Mishap m, int times = 1);
  /// Puts the withheld replies on the link. RTU only.
  void release_withheld();
  /// Vanishes, or comes back at the same place.
  void stop();
  void start();

 private:
  void run();
  bool open_link();  ///< waits a moment for a client
  bool serve_one(modbus_t* context, modbus_mapping_t* mapping);
  bool reply(modbus_t* context, const std::uint8_t* query, int length, modbus_mapping_t* mapping);
  Mishap next_mishap();

  Registers& registers_;
  const Link link_;
  const int unit_;
  int listener_ = -1, port_ = 0;
  int pty_master_ = -1, pty_slave_ = -1;
  std::string pty_path_;
  std::mutex mutex_;
  std::deque<Mishap> mishaps_;
  std::vector<std::uint8_t> withheld_;
  std::atomic<bool> running_ = false;
  std::thread thread_;
};

}  // namespace celadon::test
