#include "sim/modbus_port.h"

#include <algorithm>
#include <array>

namespace celadon::sim {
namespace {

constexpr std::uint8_t kReadHolding = 3, kReadInput = 4, kWriteOne = 6, kWriteMany = 16;
constexpr std::size_t kMaxPdu = 253;

std::uint16_t word(std::span<const std::uint8_t> b, std::size_t at) {
  return static_cast<std::uint16_t>((b[at] << 8) | b[at + 1]);
}
void put(std::vector<std::uint8_t>& out, std::uint16_t v) {
  out.push_back(static_cast<std::uint8_t>(v >> 8));
  out.push_back(static_cast<std::uint8_t>(v));
}

}  // namespace

std::uint16_t modbus_crc(std::span<const std::uint8_t> bytes) {
  std::uint16_t crc = 0xffff;
  for (const std::uint8_t byte : bytes) {
    crc = static_cast<std::uint16_t>(crc ^ byte);
    for (int bit = 0; bit < 8; ++bit) crc = static_cast<std::uint16_t>((crc >> 1) ^ ((crc & 1) != 0 ? 0xa001 : 0));
  }
  return crc;
}

std::optional<ModbusRequest> ModbusReader::next() {
  return framing_ == ModbusFraming::tcp ? next_tcp() : next_rtu();
}

std::optional<ModbusRequest> ModbusReader::next_tcp() {
  constexpr std::size_t kHeader = 7;
  if (broken_ || buffer_.size() < kHeader) return std::nullopt;
  const std::uint16_t protocol_id = word(buffer_, 2), length = word(buffer_, 4);
  if (protocol_id != 0 || length < 2 || length > kMaxPdu + 1) {
    broken_ = true;
    return std::nullopt;
  }
  if (buffer_.size() < std::size_t{6} + length) return std::nullopt;
  ModbusRequest request{word(buffer_, 0), buffer_[6], {buffer_.begin() + kHeader, buffer_.begin() + 6 + length}};
  buffer_.erase(buffer_.begin(), buffer_.begin() + 6 + length);
  return request;
}

// The length follows from the function code; a wrong CRC means that the beginning was not one.
std::optional<ModbusRequest> ModbusReader::next_rtu() {
  while (buffer_.size() >= 2) {
    std::size_t length = 8;  // unit, function, two words, CRC
    if (buffer_[1] == kWriteMany) {
      if (buffer_.size() < 7) return std::nullopt;
      length = std::size_t{9} + buffer_[6];
    }
    if (length <= kMaxPdu + 3) {
      if (buffer_.size() < length) return std::nullopt;
      const std::uint16_t crc = static_cast<std::uint16_t>(buffer_[length - 2] | (buffer_[length - 1] << 8));
      if (modbus_crc({buffer_.data(), length - 2}) == crc) {
        const auto at = static_cast<std::ptrdiff_t>(length);
        ModbusRequest request{0, buffer_[0], {buffer_.begin() + 1, buffer_.begin() + at - 2}};
        buffer_.erase(buffer_.begin(), buffer_.begin() + at);
        return request;
      }
    }
    buffer_.erase(buffer_.begin());
  }
  return std::nullopt;
}

std::vector<std::uint8_t> modbus_exception(std::span<const std::uint8_t> pdu, std::uint8_t code) {
  return {static_cast<std::uint8_t>((pdu.empty() ? 0 : pdu[0]) | 0x80), code};
}

std::vector<std::uint8_t> answer_modbus(std::span<const std::uint8_t> pdu, Registers& registers) {
  using protocol::Exception;
  const auto refuse = [&](Exception e) { return modbus_exception(pdu, static_cast<std::uint8_t>(e)); };
  if (pdu.empty()) return refuse(Exception::illegal_function);
  const std::uint8_t function = pdu[0];
  std::array<std::uint16_t, 125> words{};
  if (function == kReadHolding || function == kReadInput) {
    if (pdu.size() != 5) return refuse(Exception::illegal_value);
    const std::uint16_t address = word(pdu, 1), count = word(pdu, 3);
    if (count < 1 || count > words.size()) return refuse(Exception::illegal_value);
    const Exception e = function == kReadInput ? registers.read_input(address, count, words.data())
                                               : registers.read_holding(address, count, words.data());
    if (e != Exception::none) return refuse(e);
    std::vector<std::uint8_t> out{function, static_cast<std::uint8_t>(2 * count)};
    for (std::size_t i = 0; i < count; ++i) put(out, words[i]);
    return out;
  }
  if (function == kWriteOne) {
    if (pdu.size() != 5) return refuse(Exception::illegal_value);
    words[0] = word(pdu, 3);
    const Exception e = registers.write_holding(word(pdu, 1), 1, words.data());
    if (e != Exception::none) return refuse(e);
    return {pdu.begin(), pdu.end()};
  }
  if (function == kWriteMany) {
    if (pdu.size() < 6) return refuse(Exception::illegal_value);
    const std::uint16_t address = word(pdu, 1), count = word(pdu, 3);
    if (count < 1 || count > 123 || pdu[5] != 2 * count || pdu.size() != std::size_t{6} + 2 * count) {
      return refuse(Exception::illegal_value);
    }
    for (std::size_t i = 0; i < count; ++i) words[i] = word(pdu, 6 + 2 * i);
    const Exception e = registers.write_holding(address, count, words.data());
    if (e != Exception::none) return refuse(e);
    return {pdu.begin(), pdu.begin() + 5};
  }
  return refuse(Exception::illegal_function);
}

std::vector<std::uint8_t> frame_modbus(ModbusFraming framing, const ModbusRequest& request,
                                       std::span<const std::uint8_t> pdu) {
  std::vector<std::uint8_t> out;
  if (framing == ModbusFraming::tcp) {
    put(out, request.transaction);
    put(out, 0);
    put(out, static_cast<std::uint16_t>(pdu.size() + 1));
  }
  out.push_back(request.unit);
  out.insert(out.end(), pdu.begin(), pdu.end());
  if (framing == ModbusFraming::rtu) {
    const std::uint16_t crc = modbus_crc(out);
    out.push_back(static_cast<std::uint8_t>(crc));
    out.push_back(static_cast<std::uint8_t>(crc >> 8));
  }
  return out;
}

}  // namespace celadon::sim
