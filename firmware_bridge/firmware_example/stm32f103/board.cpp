// The example's wires on an STM32F103 (ST RM0008 names the registers) with an 8 MHz crystal.
//
//   PA9, PA10   USART1, 115200 baud, even parity, to an RS-485 transceiver that switches by itself, or a USB adapter
//   PA0         laser enable, active high, resistor to ground
//   PA1         lamp
//   PA2 PA3 PA4 motor: enable (active high, resistor to ground), direction, step
//   PB0         interlock contact to ground while closed
//   PB1         emergency stop's contact to ground while released
//   PB5         button to ground
//   PB6         index switch to ground
//   PB7         photodiode's comparator, high in light
#include "firmware_bridge/firmware_example/board.h"

#include "firmware_bridge/firmware_example/stm32f103/board_start.h"

namespace celadon::example {
namespace {

using Register = volatile std::uint32_t;

Register& at(std::uint32_t address) {
  return *reinterpret_cast<Register*>(address);
}

constexpr std::uint32_t kRcc = 0x4002'1000, kFlash = 0x4002'2000, kPortA = 0x4001'0800, kPortB = 0x4001'0C00,
                        kUsart = 0x4001'3800, kWatchdog = 0x4000'3000, kInterruptEnable = 0xE000'E100,
                        kDebugControl = 0xE000'EDFC, kCycleControl = 0xE000'1000, kCycles = 0xE000'1004;
constexpr std::uint32_t kClockHz = 72'000'000, kBaud = 115'200;

constexpr std::uint32_t kInput = 8, kBitSet = 16, kPortOutput = 12;  // offsets in a port
constexpr unsigned kLaser = 0, kLamp = 1, kMotor = 2, kDirection = 3, kStep = 4;
constexpr unsigned kInterlock = 0, kEmergencyStop = 1, kButton = 5, kIndex = 6, kLight = 7;

constexpr std::uint32_t kReceived = 1u << 5, kSendable = 1u << 7, kParityError = 1u << 0, kFramingError = 1u << 1;
constexpr unsigned kUsartInterrupt = 37;

void set(unsigned pin, bool high) {
  at(kPortA + kBitSet) = 1u << (high ? pin : pin + 16);
}
bool is_low(unsigned pin) {
  return (at(kPortB + kInput) >> pin & 1) == 0;
}

// Filled by the interrupt, emptied by the loop: each index has one writer.
constexpr unsigned kQueue = 256;
volatile std::uint8_t queue[kQueue];
volatile std::uint8_t queue_end = 0;
std::uint8_t queue_begin = 0;

}  // namespace

void start_board() {
  // 72 MHz: crystal, PLL times 9, two wait states of the flash, APB1 at half.
  at(kRcc) = at(kRcc) | 1u << 16;
  while ((at(kRcc) & 1u << 17) == 0) {
  }
  at(kFlash) = (at(kFlash) & ~7u) | 2u;
  at(kRcc + 4) = 1u << 16 | 7u << 18 | 4u << 8;
  at(kRcc) = at(kRcc) | 1u << 24;
  while ((at(kRcc) & 1u << 25) == 0) {
  }
  at(kRcc + 4) = at(kRcc + 4) | 2u;
  while ((at(kRcc + 4) >> 2 & 3u) != 2) {
  }
  at(kRcc + 0x18) = 1u << 2 | 1u << 3 | 1u << 14;  // ports A and B, USART1
  at(kPortA + kPortOutput) = 0;
  at(kPortA) = 0x4442'2222;      // PA0..PA4: outputs
  at(kPortA + 4) = 0x4444'44B4;  // PA9: the USART's output
  at(kPortB + kPortOutput) = 1u << kInterlock | 1u << kEmergencyStop | 1u << kButton | 1u << kIndex;  // pulled up
  at(kPortB) = 0x4884'4488;  // PB0, PB1, PB5, PB6: inputs with a resistor

  at(kUsart + 8) = (kClockHz + kBaud / 2) / kBaud;
  // On, nine bits of which one is parity, interrupt at a byte, sender and receiver.
  at(kUsart + 12) = 1u << 13 | 1u << 12 | 1u << 10 | 1u << 5 | 1u << 3 | 1u << 2;
  at(kInterruptEnable + 4 * (kUsartInterrupt / 32)) = 1u << kUsartInterrupt % 32;

  at(kDebugControl) = at(kDebugControl) | 1u << 24;
  at(kCycles) = 0;
  at(kCycleControl) = at(kCycleControl) | 1u;

  at(kWatchdog) = 0x5555;
  at(kWatchdog + 4) = 0;    // 40 kHz / 4
  at(kWatchdog + 8) = 200;  // 20 ms
  at(kWatchdog) = 0xCCCC;
}

void usart_interrupt() {
  const std::uint32_t state = at(kUsart);
  const auto byte = static_cast<std::uint8_t>(at(kUsart + 4));
  if ((state & kReceived) == 0) return;
  // A byte with an error breaks its frame: the checksum will not fit.
  const bool broken = (state & (kParityError | kFramingError)) != 0;
  const std::uint8_t end = queue_end;
  queue[end] = broken ? static_cast<std::uint8_t>(~byte) : byte;
  queue_end = static_cast<std::uint8_t>(end + 1);
}

namespace board {

std::uint64_t now_us() {
  static std::uint32_t last_cycles = 0, rest = 0;
  static std::uint64_t time_us = 0;
  const std::uint32_t cycles = at(kCycles);
  constexpr std::uint32_t kCyclesPerUs = kClockHz / 1'000'000;
  const std::uint32_t passed = cycles - last_cycles;  // less than the counter's 59 s between two calls
  last_cycles = cycles;
  time_us += passed / kCyclesPerUs;
  rest += passed % kCyclesPerUs;
  time_us += rest / kCyclesPerUs;
  rest %= kCyclesPerUs;
  return time_us;
}

int receive_byte() {
  if (queue_begin == queue_end) return -1;
  return queue[queue_begin++];
}

bool send_byte(std::uint8_t byte) {
  if ((at(kUsart) & kSendable) == 0) return false;
  at(kUsart + 4) = byte;
  return true;
}

bool interlock_closed() {
  return is_low(kInterlock);
}
bool emergency_stop_pressed() {
  return !is_low(kEmergencyStop);
}
bool button_down() {
  return is_low(kButton);
}
bool index_seen() {
  return is_low(kIndex);
}
bool laser_emits() {
  return !is_low(kLight);
}
void set_laser(bool enabled) {
  set(kLaser, enabled);
}
void set_lamp(bool lit) {
  set(kLamp, lit);
}
void set_motor(bool enabled) {
  set(kMotor, enabled);
}

void step_motor(bool forward) {
  set(kDirection, forward);
  set(kStep, true);
  const std::uint32_t begun = at(kCycles);
  while (at(kCycles) - begun < 2 * (kClockHz / 1'000'000)) {  // the driver wants 2 us
  }
  set(kStep, false);
}

void feed_watchdog() {
  at(kWatchdog) = 0xAAAA;
}

}  // namespace board
}  // namespace celadon::example
