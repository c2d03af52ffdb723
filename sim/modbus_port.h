#pragma once
// Modbus as bytes: requests out of a stream, answers back, for TCP and RTU. No sockets here. Functions 3, 4, 6 and 16.
// Written out instead of taken from libmodbus: its server waits inside a half-sent request, which one poll loop for all
// clients can not afford; and the scanner's libmodbus client then meets an independent implementation.

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "firmware_bridge/protocol.h"

namespace celadon::sim {

/// What answers requests.
class Registers {
 public:
  virtual protocol::Exception read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) = 0;
  virtual protocol::Exception read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words) = 0;
  virtual protocol::Exception write_holding(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) = 0;

 protected:
  ~Registers() = default;
};

enum class ModbusFraming : std::uint8_t { tcp, rtu };

/// One request cut out of the stream.
struct ModbusRequest {
  std::uint16_t transaction = 0;  ///< TCP
  std::uint8_t unit = 0;
  std::vector<std::uint8_t> pdu;  ///< function code and data
};

/// Cuts requests out of a byte stream.
class ModbusReader {
 public:
  explicit ModbusReader(ModbusFraming framing) : framing_(framing) {}
  void append(std::span<const std::uint8_t> bytes) { buffer_.insert(buffer_.end(), bytes.begin(), bytes.end()); }
  /// The next whole request. RTU: bytes that make no request with a right CRC are skipped one by one.
  std::optional<ModbusRequest> next();
  /// TCP: the stream does not carry Modbus; close the connection.
  bool broken() const { return broken_; }
  /// RTU: a pause on the line ends whatever was begun.
  void pause() { buffer_.clear(); }

 private:
  std::optional<ModbusRequest> next_tcp();
  std::optional<ModbusRequest> next_rtu();

  ModbusFraming framing_;
  std::vector<std::uint8_t> buffer_;
  bool broken_ = false;
};

/// Answer PDU of a request PDU; malformed ones are answered with exception 1 or 3.
std::vector<std::uint8_t> answer_modbus(std::span<const std::uint8_t> pdu, Registers& registers);
/// Exception answer to a request PDU.
std::vector<std::uint8_t> modbus_exception(std::span<const std::uint8_t> pdu, std::uint8_t code);
/// PDU with its framing.
std::vector<std::uint8_t> frame_modbus(ModbusFraming framing, const ModbusRequest& request,
                                       std::span<const std::uint8_t> pdu);
/// CRC-16 of Modbus RTU (polynomial 0xA001 reflected, start 0xFFFF).
std::uint16_t modbus_crc(std::span<const std::uint8_t> bytes);

}  // namespace celadon::sim
