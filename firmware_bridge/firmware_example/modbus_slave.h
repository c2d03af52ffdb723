#pragma once
// A Modbus RTU server for one controller core: bytes in, bytes out ("MODBUS over Serial Line V1.02", modbus.org).
// Functions 3, 4, 6 and 16; every other is answered with exception 1. Broken frames and those of other units are not.

#include <cstdint>

#include "firmware_bridge/controller_core.h"

namespace celadon::example {

class ModbusSlave {
 public:
  ModbusSlave(ControllerCore& core, std::uint8_t unit) : core_(core), unit_(unit) {}

  /// A byte came. While an answer waits to be sent, bytes are not a request.
  void receive(std::uint8_t byte, std::uint64_t now_us);
  /// Ends a frame after a silence of 1.75 ms (3.5 characters at 19200 baud and above) and answers it.
  void advance(std::uint64_t now_us);
  /// The next byte to send; -1: none.
  int next_byte() const { return sent_ < length_ && answering_ ? frame_[sent_] : -1; }
  /// That byte was sent.
  void sent();

 private:
  void answer(std::uint64_t now_us);
  protocol::Exception serve(std::uint64_t now_us, std::uint16_t& reply_bytes);
  std::uint16_t word(int at) const { return static_cast<std::uint16_t>(frame_[at] << 8 | frame_[at + 1]); }

  static constexpr int kLongest = 256;
  ControllerCore& core_;
  const std::uint8_t unit_;
  std::uint8_t frame_[kLongest] = {};
  int length_ = 0, sent_ = 0;
  bool answering_ = false, too_long_ = false;
  std::uint64_t last_byte_us_ = 0;
};

/// CRC of a frame, as sent: low byte first.
std::uint16_t modbus_crc(const std::uint8_t* bytes, int count);

}  // namespace celadon::example
