#pragma once
// Where and how a Modbus controller is reached, from its URL.

#include <string>
#include <variant>

#include <tl/expected.hpp>

namespace celadon {

struct ModbusTcpPlace {
  std::string host;  ///< name, IPv4 or IPv6 address (without brackets)
  int port = 502;
};

struct ModbusRtuPlace {
  std::string device;
  int baud = 115200;
  char parity = 'E';
  int stop_bits = 1;
  bool rs485 = false;
};

struct ModbusPlace {
  std::variant<ModbusTcpPlace, ModbusRtuPlace> link;
  int unit = 255;
  int timeout_ms = 500;
};

/// Parses a modbus-tcp: or modbus-rtu: URL; the error is one clause that names the part and what is allowed there.
tl::expected<ModbusPlace, std::string> parse_modbus_url(const std::string& url);

}  // namespace celadon
