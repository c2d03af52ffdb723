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

/// A position sample that the controller sent by itself (PROTOCOL.md, USB).
struct TraceSample {
  std::uint64_t time_us = 0;       ///< the controller's clock
  std::uint32_t counter = 0;       ///< of position samples; a gap shows lost ones
  std::int64_t position_udeg = 0;  ///< unwrapped
  std::int32_t speed_udeg_per_s = 0;
};

/// One exchange at a time, from one thread: Modbus TCP and RTU, USB control requests.
class Transport {
 public:
  virtual ~Transport() = default;
  virtual tl::expected<void, LinkError> read_inputs(std::uint16_t address, std::span<std::uint16_t> registers) = 0;
  virtual tl::expected<void, LinkError> read_holding(std::uint16_t address, std::span<std::uint16_t> registers) = 0;
  virtual tl::expected<void, LinkError> write_holding(std::uint16_t address,
                                                      std::span<const std::uint16_t> registers) = 0;
  virtual tl::expected<void, LinkError> reconnect() = 0;
  virtual const std::string& url() const = 0;
  /// How often the link was opened, the first time too; an exchange over a closed one opens it. 0: it is not counted.
  virtual std::uint64_t connections() const { return 0; }
  /// What works less well than asked for, one sentence; empty if nothing.
  virtual std::string warning() const { return {}; }
  /// What the device's own number of a fault (status.fault_detail) stands for, one clause; empty if it is not known.
  virtual std::string fault_text(std::uint16_t /*detail*/) const { return {}; }

  // What the controller tells by itself. It shortens waits and fills gaps; the registers remain the truth.
  /// Whether it tells of changes; else waiting for them is polling.
  virtual bool has_events() const { return false; }
  /// Waits in real time until the state has changed since the last call, or wait_ns are over. @returns whether to poll:
  /// also when the link is down
  virtual bool wait_for_event(std::int64_t /*wait_ns*/) { return false; }
  /// Position samples since the last call, oldest first, at most samples.size(). The first call starts the trace.
  virtual std::size_t take_trace(std::span<TraceSample> /*samples*/) { return 0; }
};

/// "modbus-tcp://HOST[:PORT][?unit=N&timeout_ms=N]",
/// "modbus-rtu:/dev/ttyX[?baud=N&parity=N|E|O&stop=1|2&unit=N&rs485=0|1&timeout_ms=N]",
/// "usb:[VID:PID][/SERIAL][?timeout_ms=N]" or "usb:SERIAL": the one controller that fits.
/// Defaults: port 502; unit 255 over TCP, 1 over RTU; 115200 baud, even parity, 1 stop bit, no RS-485 control by the
/// driver; 500 ms for a reply. An IPv6 address stands in brackets.
tl::expected<std::unique_ptr<Transport>, DeviceError> open_transport(const std::string& url);

}  // namespace celadon
