#pragma once
// The device protocol over USB as data: requests, and the records that the controller sends by itself, made of
// registers of protocol.h. PROTOCOL.md, USB. Freestanding, as protocol.h.

#include "firmware_bridge/protocol.h"

namespace celadon::protocol::usb {

/// pid.codes' pair for tests: for machines that stay in the house. Whoever sells a controller needs a pair of his own.
inline constexpr std::uint16_t kVendorId = 0x1209, kProductId = 0x0001;

/// A vendor-specific interface of this triple is a Celadon controller, whatever the device's VID:PID: class, 'C', major
/// version of the protocol.
inline constexpr std::uint8_t kInterfaceClass = 0xFF, kInterfaceSubclass = 0x43, kInterfaceProtocol = kMajor;

/// bRequest of vendor requests to the interface. X(name, value, direction, meaning)
#define CELADON_USB_REQUESTS(X)                                                   \
  X(read_input, 1, "in", "wLength / 2 input registers from address wValue")       \
  X(read_holding, 2, "in", "wLength / 2 holding registers from address wValue")   \
  X(write_holding, 3, "out", "wLength / 2 holding registers from address wValue") \
  X(exception, 4, "in", "2 bytes: exception code of the last of the requests above on this interface, 0 for none")

#define CELADON_USB_ENUMERATOR(name, value, direction, meaning) name = (value),
enum class Request : std::uint8_t { CELADON_USB_REQUESTS(CELADON_USB_ENUMERATOR) };
#undef CELADON_USB_ENUMERATOR

/// bmRequestType: vendor request to an interface.
inline constexpr std::uint8_t kTypeIn = 0xC1, kTypeOut = 0x41;
/// Most data of one request: one block is at most what one Modbus request carries.
inline constexpr std::uint16_t kMaxRegisters = 125;

/// The event record: its registers' words one after the other, of axis 0.
inline constexpr Register kEventRegisters[] = {reg::status::uptime,         reg::status::flags,
                                               reg::status::fault_code,     reg::status::fault_detail,
                                               reg::status::button_presses, reg::status::lasers_measured,
                                               reg::status::lasers_enabled, reg::axis_status::motion_state};
/// The trace record, of axis 0.
inline constexpr Register kTraceRegisters[] = {reg::axis_status::position_time, reg::axis_status::position_counter,
                                               reg::axis_status::angle, reg::axis_status::turns,
                                               reg::axis_status::speed};

template <std::size_t N>
constexpr std::uint16_t words_of(const Register (&registers)[N]) {
  std::uint16_t words = 0;
  for (const Register& r : registers) words = static_cast<std::uint16_t>(words + r.words());
  return words;
}
inline constexpr std::uint16_t kEventWords = words_of(kEventRegisters), kTraceWords = words_of(kTraceRegisters);
inline constexpr std::uint16_t kEventBytes = 2 * kEventWords, kTraceBytes = 2 * kTraceWords;
static_assert(kEventBytes <= 64, "one packet at full speed");

/// Words from the start of a record to a register of it. @pre r is one of the record's
template <std::size_t N>
constexpr std::uint16_t offset_of(const Register (&record)[N], const Register& r) {
  std::uint16_t words = 0;
  for (const Register& other : record) {
    if (other.address() == r.address()) break;
    words = static_cast<std::uint16_t>(words + other.words());
  }
  return words;
}

constexpr std::uint16_t get_word(const std::uint8_t* bytes) {
  return static_cast<std::uint16_t>((bytes[0] << 8) | bytes[1]);
}
constexpr void put_word(std::uint8_t* bytes, std::uint16_t word) {
  bytes[0] = static_cast<std::uint8_t>(word >> 8);
  bytes[1] = static_cast<std::uint8_t>(word);
}

}  // namespace celadon::protocol::usb
