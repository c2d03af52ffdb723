#include "tests/firmware_bridge/simulated_board.h"

#include "firmware_bridge/firmware_example/board.h"

namespace celadon::test {

SimulatedBoard& simulated_board() {
  static SimulatedBoard board;
  return board;
}

}  // namespace celadon::test

namespace celadon::example::board {

using test::simulated_board;

std::uint64_t now_us() {
  return simulated_board().now_us();
}
int receive_byte() {
  auto& bytes = simulated_board().received;
  if (bytes.empty()) return -1;
  const int byte = bytes.front();
  bytes.pop_front();
  return byte;
}
bool send_byte(std::uint8_t byte) {
  simulated_board().sent.push_back(byte);
  return true;
}
bool interlock_closed() {
  return simulated_board().interlock_closed;
}
bool emergency_stop_pressed() {
  return simulated_board().emergency_stop;
}
bool button_down() {
  return simulated_board().button;
}
bool index_seen() {
  constexpr std::int64_t kTurn = 32'000, kWidth = 10;
  const auto& board = simulated_board();
  const std::int64_t past = ((board.steps - board.index_at) % kTurn + kTurn) % kTurn;
  return board.index_exists && past < kWidth;
}
bool laser_emits() {
  return simulated_board().laser || simulated_board().light_stuck;
}
void set_laser(bool enabled) {
  simulated_board().laser = enabled;
}
void set_lamp(bool lit) {
  simulated_board().lamp = lit;
}
void set_motor(bool enabled) {
  simulated_board().motor = enabled;
}
void step_motor(bool forward) {
  auto& board = simulated_board();
  if (!board.motor) ++board.steps_without_power;
  board.steps += forward ? 1 : -1;
}
void feed_watchdog() {
  ++simulated_board().watchdog_fed;
}

}  // namespace celadon::example::board
