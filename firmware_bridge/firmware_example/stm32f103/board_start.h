#pragma once

namespace celadon::example {

/// Clock, pins, serial line, cycle counter, watchdog. Lasers and motor are off.
void start_board();
/// Of USART1.
void usart_interrupt();

}  // namespace celadon::example
