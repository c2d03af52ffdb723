#pragma once
// Blocks of 16-bit registers read and written on a controller, over any link.

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include <tl/expected.hpp>

#include "firmware_bridge/device_error.h"

namespace celadon {

/// Why one exchange failed; the caller above adds operation and machine state.
struct LinkError {
  DeviceError::Kind kind = DeviceError::Kind::lost;
  int code = 0;  ///< errno or Modbus exception
  std::string cause;
  bool retry_may_help = true;
};

/// One exchange at a time, from one thread. Modbus TCP and RTU today; USB control requests fit the same shape.
class Transport {
 public:
  virtual ~Transport() = default;
  virtual tl::expected<void, LinkError> read_inputs(std::uint16_t address, std::span<std::uint16_t> registers) = 0;
  virtual tl::expected<void, LinkError> read_holding(std::uint16_t address, std::span<std::uint16_t> registers) = 0;
  virtual tl::expected<void, LinkError> write_holding(std::uint16_t address,
                                                      std::span<const std::uint16_t> registers) = 0;
  virtual tl::expected<void, LinkError> reconnect() = 0;
  virtual const std::string& url() const = 0;
  /// What works less well than asked for, one sentence; empty if nothing.
  virtual std::string warning() const { return {}; }
};

/// "modbus-tcp://HOST[:PORT][?unit=N&timeout_ms=N]",
/// "modbus-rtu:/dev/ttyX[?baud=N&parity=N|E|O&stop=1|2&unit=N&rs485=0|1&timeout_ms=N]",
/// "usb:[VID:PID][/SERIAL]" (named and refused until the USB transport exists).
/// Defaults: port 502; unit 255 over TCP, 1 over RTU; 115200 baud, even parity, 1 stop bit, no RS-485 control by the
/// driver; 500 ms for a reply. An IPv6 address stands in brackets.
tl::expected<std::unique_ptr<Transport>, DeviceError> open_transport(const std::string& url);

}  // namespace celadon
