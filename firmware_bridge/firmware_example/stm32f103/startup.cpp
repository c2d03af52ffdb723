// From reset to the loop: vectors, memory, and the four functions that a compiler may call by itself.
#include <cstddef>
#include <cstdint>

#include "firmware_bridge/firmware_example/board.h"
#include "firmware_bridge/firmware_example/firmware.h"
#include "firmware_bridge/firmware_example/stm32f103/board_start.h"

extern "C" {
// Of link.ld.
extern std::uint32_t stack_top, data_start, data_end, data_source, bss_start, bss_end;

void* memset(void* to, int value, std::size_t count) {
  auto* bytes = static_cast<volatile std::uint8_t*>(to);
  for (std::size_t i = 0; i < count; ++i) bytes[i] = static_cast<std::uint8_t>(value);
  return to;
}
void* memcpy(void* to, const void* from, std::size_t count) {
  auto* bytes = static_cast<volatile std::uint8_t*>(to);
  for (std::size_t i = 0; i < count; ++i) bytes[i] = static_cast<const std::uint8_t*>(from)[i];
  return to;
}
void* memmove(void* to, const void* from, std::size_t count) {
  if (to <= from) return memcpy(to, from, count);
  auto* bytes = static_cast<volatile std::uint8_t*>(to);
  for (std::size_t i = count; i > 0; --i) bytes[i - 1] = static_cast<const std::uint8_t*>(from)[i - 1];
  return to;
}
int memcmp(const void* a, const void* b, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    const int difference = static_cast<const volatile std::uint8_t*>(a)[i] - static_cast<const std::uint8_t*>(b)[i];
    if (difference != 0) return difference;
  }
  return 0;
}

[[noreturn]] void reset();
// Whatever else interrupts is a defect: the watchdog resets the board, dark and still.
[[noreturn]] void defect() {
  for (;;) {
  }
}
void usart1() {
  celadon::example::usart_interrupt();
}
}

namespace {

using Vector = void (*)();
constexpr int kSystemVectors = 16, kUsart1 = kSystemVectors + 37;

struct Vectors {
  std::uint32_t* stack;
  Vector vector[kUsart1];  // from 1 on
};

// Survives a reset, and is anything after power-up.
[[gnu::section(".noinit")]] std::uint16_t boot_count;

constexpr Vectors make_vectors() {
  Vectors v{&stack_top, {}};
  for (Vector& vector : v.vector) vector = defect;
  v.vector[0] = reset;
  v.vector[kUsart1 - 1] = usart1;
  return v;
}

[[gnu::section(".vectors"), gnu::used]] constinit const Vectors kVectors = make_vectors();

}  // namespace

void reset() {
  for (std::uint32_t *to = &data_start, *from = &data_source; to < &data_end;) *to++ = *from++;
  for (std::uint32_t* to = &bss_start; to < &bss_end;) *to++ = 0;
  celadon::example::start_board();
  using celadon::example::board::now_us;
  celadon::example::Firmware firmware(celadon::example::machine_config(false), ++boot_count, now_us());
  for (;;) firmware.run_once(now_us());
}
