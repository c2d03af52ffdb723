#pragma once
// A controller core on its closed-form plant with a clock that the test turns.

#include <vector>

#include "firmware_bridge/controller_core.h"
#include "tests/firmware_bridge/test_plant.h"

namespace celadon::test {

class CoreBench {
 public:
  explicit CoreBench(ControllerConfig config = test_config()) : config_(config), core(config, plant, 1, 0) {}

  std::uint64_t now_us = 0;

 private:
  ControllerConfig config_;

 public:
  TestPlant plant;
  ControllerCore core;

  /// Steps at every deadline on the way, as firmware on a fine tick would.
  void advance_to(std::uint64_t time_us) {
    while (now_us < time_us) {
      std::uint64_t next = std::min(time_us, now_us + 10'000);
      if (core.next_deadline_us() > now_us) next = std::min(next, core.next_deadline_us());
      now_us = next;
      core.step(now_us);
    }
  }
  void advance_ms(std::uint64_t ms) { advance_to(now_us + ms * 1000); }
  /// The same, with the host polling every 100 ms.
  void advance_polling_ms(std::uint64_t ms) {
    for (const std::uint64_t end = now_us + ms * 1000; now_us < end;) {
      poll();
      advance_to(std::min(end, now_us + 100'000));
    }
  }

  std::vector<std::uint16_t> poll() {
    std::vector<std::uint16_t> words(protocol::status_words(config_.axes));
    core.read_input(now_us, 0, static_cast<std::uint16_t>(words.size()), words.data());
    return words;
  }
  protocol::Exception write(std::uint16_t address, std::vector<std::uint16_t> words) {
    plant.inside_write = true;
    const auto result = core.write_holding(now_us, address, static_cast<std::uint16_t>(words.size()), words.data());
    plant.inside_write = false;
    return result;
  }
  protocol::Exception grant(int laser, std::uint16_t lease_ms) {
    return write(static_cast<std::uint16_t>(protocol::reg::control::laser_lease.address() + laser), {lease_ms});
  }
  protocol::Exception command(std::uint16_t code, std::int64_t target_udeg = 0, std::uint32_t speed = 90'000'000,
                              std::uint16_t sequence = 0, int axis = 0) {
    std::vector<std::uint16_t> words(10);
    const auto target = protocol::split_turns(target_udeg);
    protocol::put_s32(&words[0], target.angle_udeg);
    protocol::put_s32(&words[2], target.turns);
    protocol::put_u32(&words[4], speed);
    words[8] = sequence;
    words[9] = code;
    return write(protocol::groups::axis_command.address(axis), words);
  }
  protocol::Exception home(int axis = 0) { return command(protocol::kHome, 0, 0, 0, axis); }
  protocol::Exception make_safe() { return write(protocol::reg::control::make_safe.address(), {1}); }
  protocol::Exception clear_fault() { return write(protocol::reg::control::clear_fault.address(), {1}); }
  Refusal refusal() { return static_cast<Refusal>(poll()[protocol::reg::status::refusal.address()]); }
  std::uint16_t flags() { return poll()[protocol::reg::status::flags.address()]; }

  void press_button(std::uint64_t held_ms = 100) {
    plant.button = true;
    core.step(now_us);
    advance_ms(held_ms);
    plant.button = false;
    core.step(now_us);
    advance_ms(100);
  }
  void home_and_wait() {
    for (int axis = 0; axis < config_.axes; ++axis) home(axis);
    advance_polling_ms(6000);
  }
};

}  // namespace celadon::test
