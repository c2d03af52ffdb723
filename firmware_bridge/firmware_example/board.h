#pragma once
// What the example needs of a board, one function a wire. A port to another board is another file that defines these:
// stm32f103/board.cpp for a microcontroller, board_host.cpp for a board that is simulated in a Linux process. All are
// called from one thread and return at once.

#include <cstdint>

namespace celadon::example::board {

/// Microseconds since the start; never goes back.
std::uint64_t now_us();

/// The next byte that the serial line received; -1: none.
int receive_byte();
/// @return false where the line is not ready for it yet
bool send_byte(std::uint8_t byte);

bool interlock_closed();
bool emergency_stop_pressed();
bool button_down();
/// Once a turn, over a few steps.
bool index_seen();
/// By a photodiode, whatever set_laser() said.
bool laser_emits();

/// Enable lines are pulled to "off" by resistors, so that a board without firmware is dark and still.
void set_laser(bool enabled);
void set_lamp(bool lit);
void set_motor(bool enabled);
/// One microstep.
void step_motor(bool forward);

/// Resets the board unless it is called again within some ten milliseconds.
void feed_watchdog();

}  // namespace celadon::example::board
