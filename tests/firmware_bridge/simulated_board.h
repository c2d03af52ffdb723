#pragma once
// The board of the firmware example as a Linux process has it: wires are variables, the table turns by counted steps.

#include <atomic>
#include <cstdint>
#include <deque>
#include <functional>

namespace celadon::test {

struct SimulatedBoard {
  std::function<std::uint64_t()> now_us;
  std::deque<std::uint8_t> received, sent;  ///< of the firmware's thread
  std::atomic<bool> interlock_closed = true, emergency_stop = false, button = false, light_stuck = false;
  std::atomic<bool> index_exists = true;
  std::atomic<bool> laser = false, lamp = false, motor = false;
  std::atomic<std::int64_t> steps = 0;  ///< of the table, from where it stood at first
  std::int64_t index_at = 2'000;        ///< first of ten steps, each turn
  std::uint64_t steps_without_power = 0, watchdog_fed = 0;
};

/// The one board of this program.
SimulatedBoard& simulated_board();

}  // namespace celadon::test
