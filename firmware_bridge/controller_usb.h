#pragma once
// The controller's side of USB, for firmware and for the virtual scanner: set-ups of vendor requests become reads and
// writes of registers; changes become events, position samples a trace. The USB stack is the caller's. Freestanding: no
// heap, no operating system, no exceptions, no floating point, no threads.

#include <cstdint>

#include "firmware_bridge/usb_protocol.h"

namespace celadon {

/// What answers: the controller core at the present instant.
class UsbRegisters {
 public:
  virtual protocol::Exception read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) = 0;
  virtual protocol::Exception read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words) = 0;
  virtual protocol::Exception write_holding(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) = 0;

 protected:
  ~UsbRegisters() = default;
};

/// The eight bytes that begin a control transfer (USB 2.0, table 9-2).
struct UsbSetup {
  std::uint8_t request_type = 0, request = 0;
  std::uint16_t value = 0, index = 0, length = 0;

  static constexpr UsbSetup from_bytes(const std::uint8_t* b) {
    const auto word = [b](int at) { return static_cast<std::uint16_t>(b[at] | (b[at + 1] << 8)); };
    return {b[0], b[1], word(2), word(4), word(6)};
  }
};

class ControllerUsb {
 public:
  static constexpr int kStall = -1;
  static constexpr int kTraceSamples = 128;  ///< kept while nobody reads; older ones are dropped

  explicit ControllerUsb(UsbRegisters& registers) : registers_(registers) {}
  ControllerUsb(const ControllerUsb&) = delete;
  ControllerUsb& operator=(const ControllerUsb&) = delete;

  /// A vendor request to the interface that asks for data.
  /// @pre data holds 2 * protocol::usb::kMaxRegisters bytes
  /// @returns the number of bytes to send, or kStall
  int control_in(const UsbSetup& setup, std::uint8_t* data);
  /// A vendor request to the interface with its data; `count` bytes came. @returns 0 or kStall
  int control_out(const UsbSetup& setup, const std::uint8_t* data, int count);

  /// Call it as often as the plant samples its position: it notes a new sample for the trace.
  void sample();
  /// Call it when the interrupt endpoint is free: the newest state if it differs from the last one taken, feeding no
  /// heartbeat; the same one again if only another axis than the table has changed its motion state. @pre data holds
  /// kEventBytes @returns kEventBytes, or 0 while nothing is new
  int take_event(std::uint8_t* data);
  /// Call it when the bulk endpoint is free: whole samples, oldest first. @returns bytes, 0 if there are none
  int take_trace(std::uint8_t* data, int capacity);
  /// After a bus reset or a set configuration: forgets the trace, and the next event is sent whatever it says.
  void reset();

 private:
  bool read_state(int axes, std::uint16_t* words);
  int axes();

  UsbRegisters& registers_;
  protocol::Exception exception_ = protocol::Exception::none;
  std::uint16_t event_[protocol::usb::kEventWords] = {};
  std::uint16_t other_motion_[protocol::kMaxAxes - 1] = {};  ///< states of the axes that the event does not hold
  bool event_sent_ = false;
  int axes_ = 0;  ///< 0: not asked for yet
  std::uint16_t trace_[kTraceSamples][protocol::usb::kTraceWords] = {};
  int trace_first_ = 0, trace_count_ = 0;
  std::uint32_t newest_counter_ = 0;
};

}  // namespace celadon
