#include "firmware_bridge/firmware_example/modbus_slave.h"

namespace celadon::example {
namespace {

using protocol::Exception;

constexpr std::uint64_t kFrameGap_us = 1'750;
constexpr int kCrcBytes = 2, kShortest = 4;
constexpr std::uint8_t kReadHolding = 3, kReadInput = 4, kWriteOne = 6, kWriteSome = 16, kExceptionBit = 0x80;
constexpr std::uint16_t kMostRead = 125, kMostWritten = 123;

}  // namespace

std::uint16_t modbus_crc(const std::uint8_t* bytes, int count) {
  std::uint16_t crc = 0xFFFF;
  for (int i = 0; i < count; ++i) {
    crc = static_cast<std::uint16_t>(crc ^ bytes[i]);
    for (int bit = 0; bit < 8; ++bit) {
      const bool odd = (crc & 1) != 0;
      crc = static_cast<std::uint16_t>(crc >> 1);
      if (odd) crc = static_cast<std::uint16_t>(crc ^ 0xA001);
    }
  }
  return crc;
}

void ModbusSlave::receive(std::uint8_t byte, std::uint64_t now_us) {
  if (answering_) return;
  last_byte_us_ = now_us;
  if (length_ == kLongest) {
    too_long_ = true;
    return;
  }
  frame_[length_++] = byte;
}

void ModbusSlave::advance(std::uint64_t now_us) {
  if (answering_ || length_ == 0 || now_us - last_byte_us_ < kFrameGap_us) return;
  answer(now_us);
}

void ModbusSlave::sent() {
  if (++sent_ < length_) return;
  answering_ = false;
  length_ = sent_ = 0;
}

void ModbusSlave::answer(std::uint64_t now_us) {
  const int content = length_ - kCrcBytes;
  const std::uint8_t address = frame_[0];
  const bool broken =
      too_long_ || length_ < kShortest ||
      modbus_crc(frame_, content) != static_cast<std::uint16_t>(frame_[content] | frame_[content + 1] << 8);
  too_long_ = false;
  if (broken || (address != unit_ && address != 0)) {
    length_ = 0;
    return;
  }
  length_ = content;
  std::uint16_t reply_bytes = 0;
  const Exception exception = serve(now_us, reply_bytes);
  length_ = 0;
  if (address == 0) return;  // to all: nobody answers
  if (exception != Exception::none) {
    frame_[1] = static_cast<std::uint8_t>(frame_[1] | kExceptionBit);
    frame_[2] = static_cast<std::uint8_t>(exception);
    reply_bytes = 3;
  }
  const std::uint16_t crc = modbus_crc(frame_, reply_bytes);
  frame_[reply_bytes] = static_cast<std::uint8_t>(crc);
  frame_[reply_bytes + 1] = static_cast<std::uint8_t>(crc >> 8);
  length_ = reply_bytes + kCrcBytes;
  sent_ = 0;
  answering_ = true;
}

/// The request in frame_, length_ bytes without its CRC; leaves the reply there.
Exception ModbusSlave::serve(std::uint64_t now_us, std::uint16_t& reply_bytes) {
  const std::uint8_t function = frame_[1];
  std::uint16_t words[kMostRead];
  if (function == kReadHolding || function == kReadInput) {
    if (length_ != 6) return Exception::illegal_value;
    const std::uint16_t first = word(2), count = word(4);
    if (count < 1 || count > kMostRead) return Exception::illegal_value;
    const Exception exception = function == kReadInput ? core_.read_input(now_us, first, count, words)
                                                       : core_.read_holding(now_us, first, count, words);
    if (exception != Exception::none) return exception;
    frame_[2] = static_cast<std::uint8_t>(2 * count);
    for (int i = 0; i < count; ++i) {
      frame_[3 + 2 * i] = static_cast<std::uint8_t>(words[i] >> 8);
      frame_[4 + 2 * i] = static_cast<std::uint8_t>(words[i]);
    }
    reply_bytes = static_cast<std::uint16_t>(3 + 2 * count);
    return Exception::none;
  }
  if (function != kWriteOne && function != kWriteSome) return Exception::illegal_function;
  int count = 1, at = 4;
  if (function == kWriteSome) {
    if (length_ < 7) return Exception::illegal_value;
    count = word(4);
    at = 7;
    if (count < 1 || count > kMostWritten || frame_[6] != 2 * count) return Exception::illegal_value;
  }
  if (length_ != at + 2 * count) return Exception::illegal_value;
  for (int i = 0; i < count; ++i) words[i] = word(at + 2 * i);
  reply_bytes = 6;  // the request's own first bytes
  return core_.write_holding(now_us, word(2), static_cast<std::uint16_t>(count), words);
}

}  // namespace celadon::example
