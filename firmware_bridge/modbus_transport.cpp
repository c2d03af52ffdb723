#include <modbus/modbus.h>
#include <netdb.h>
#include <sys/select.h>

#include <cerrno>
#include <system_error>
#include <utility>

#include "firmware_bridge/modbus_url.h"
#include "firmware_bridge/transport.h"
#include "firmware_bridge/usb_transport.h"

namespace celadon {
namespace {

using Kind = DeviceError::Kind;

struct FreeModbus {
  void operator()(modbus_t* context) const {
    modbus_close(context);
    modbus_free(context);
  }
};
using Context = std::unique_ptr<modbus_t, FreeModbus>;

// libmodbus numbers a Modbus exception MODBUS_ENOBASE + its code; its own complaints follow after the last exception.
LinkError link_error(int error, int timeout_ms) {
  if (error > MODBUS_ENOBASE && error < EMBBADCRC) {
    const int exception = error - MODBUS_ENOBASE;
    const bool passing = exception == MODBUS_EXCEPTION_ACKNOWLEDGE ||
                         exception == MODBUS_EXCEPTION_SLAVE_OR_SERVER_BUSY ||
                         exception == MODBUS_EXCEPTION_MEMORY_PARITY || exception == MODBUS_EXCEPTION_GATEWAY_TARGET;
    return {
        Kind::refused, exception,
        "the controller answered Modbus exception " + std::to_string(exception) + " (" + modbus_strerror(error) + ")",
        passing};
  }
  if (error >= EMBBADCRC && error <= EMBBADSLAVE)
    return {Kind::broken_reply, error, std::string("the reply was broken (") + modbus_strerror(error) + ")", true};
  if (error == ETIMEDOUT)
    return {Kind::timed_out, error, "no complete reply within " + std::to_string(timeout_ms) + " ms", true};
  const std::string text = std::generic_category().message(error) + " (errno " + std::to_string(error) + ")";
  if (error == ENOENT || error == EACCES || error == EPERM || error == EMFILE || error == ENFILE)
    return {error == ENOENT ? Kind::not_found : Kind::system, error, text, error != EACCES && error != EPERM};
  return {Kind::lost, error, "the link is down: " + text, true};
}

class ModbusTransport final : public Transport {
 public:
  ModbusTransport(std::string url, ModbusPlace place, Context context)
      : url_(std::move(url)), place_(std::move(place)), context_(std::move(context)) {}

  tl::expected<void, LinkError> read_inputs(std::uint16_t address, std::span<std::uint16_t> registers) override {
    return exchange(registers.size(), MODBUS_MAX_READ_REGISTERS, [&](int count) {
      return modbus_read_input_registers(context_.get(), address, count, registers.data());
    });
  }
  tl::expected<void, LinkError> read_holding(std::uint16_t address, std::span<std::uint16_t> registers) override {
    return exchange(registers.size(), MODBUS_MAX_READ_REGISTERS,
                    [&](int count) { return modbus_read_registers(context_.get(), address, count, registers.data()); });
  }
  tl::expected<void, LinkError> write_holding(std::uint16_t address,
                                              std::span<const std::uint16_t> registers) override {
    return exchange(registers.size(), MODBUS_MAX_WRITE_REGISTERS, [&](int count) {
      return modbus_write_registers(context_.get(), address, count, registers.data());
    });
  }

  tl::expected<void, LinkError> reconnect() override {
    disconnect();
    if (modbus_connect(context_.get()) != 0) return tl::unexpected(connect_error(errno));
    if (modbus_get_socket(context_.get()) >= FD_SETSIZE) {  // libmodbus waits with select()
      disconnect();
      return tl::unexpected(link_error(EMFILE, place_.timeout_ms));
    }
    connected_ = true;
    ++connections_;
    if (const auto* rtu = std::get_if<ModbusRtuPlace>(&place_.link); rtu && rtu->rs485) {
      warning_.clear();
      if (modbus_rtu_set_serial_mode(context_.get(), MODBUS_RTU_RS485) != 0)
        warning_ = "the driver of " + rtu->device + " does not control RS-485 direction (" +
                   std::generic_category().message(errno) + "); the adapter must switch by itself";
    }
    return {};
  }

  const std::string& url() const override { return url_; }
  std::uint64_t connections() const override { return connections_; }
  std::string warning() const override { return warning_; }

 private:
  template <class Call>
  tl::expected<void, LinkError> exchange(std::size_t count, int most, Call call) {
    if (count == 0 || count > static_cast<std::size_t>(most))
      return tl::unexpected(LinkError{Kind::refused, EINVAL,
                                      "a block of " + std::to_string(count) +
                                          " registers is outside Modbus's limits of 1 to " + std::to_string(most),
                                      false});
    if (!connected_) {
      if (auto connected = reconnect(); !connected) return connected;
    }
    const bool serial = std::holds_alternative<ModbusRtuPlace>(place_.link);
    // A serial reply that comes after its time-out would be taken for the next one's; TCP replies carry a number.
    if (serial) modbus_flush(context_.get());
    errno = 0;
    if (call(static_cast<int>(count)) == static_cast<int>(count)) return {};
    LinkError error = link_error(errno, place_.timeout_ms);
    // A TCP stream that lost its place cannot be trusted again; a serial line is only closed when it is gone, because
    // opening it may reset the controller.
    if (error.kind != Kind::refused && (!serial || error.kind == Kind::lost)) disconnect();
    return tl::unexpected(std::move(error));
  }

  // libmodbus says "connection refused" of a name that it cannot resolve.
  LinkError connect_error(int error) const {
    if (const auto* tcp = std::get_if<ModbusTcpPlace>(&place_.link)) {
      addrinfo* found = nullptr;
      const int code = ::getaddrinfo(tcp->host.c_str(), nullptr, nullptr, &found);
      if (code != 0) {
        return {Kind::not_found, error, "the host \"" + tcp->host + "\" is not known (" + ::gai_strerror(code) + ")",
                true};
      }
      ::freeaddrinfo(found);
    }
    return link_error(error, place_.timeout_ms);
  }

  void disconnect() {
    modbus_close(context_.get());
    connected_ = false;
  }

  std::string url_;
  ModbusPlace place_;
  Context context_;
  bool connected_ = false;
  std::uint64_t connections_ = 0;
  std::string warning_;
};

Context make_context(const ModbusPlace& place) {
  Context context;
  if (const auto* tcp = std::get_if<ModbusTcpPlace>(&place.link)) {
    context.reset(modbus_new_tcp_pi(tcp->host.c_str(), std::to_string(tcp->port).c_str()));
  } else {
    const auto& rtu = std::get<ModbusRtuPlace>(place.link);
    context.reset(modbus_new_rtu(rtu.device.c_str(), rtu.baud, rtu.parity, 8, rtu.stop_bits));
  }
  if (!context || modbus_set_slave(context.get(), place.unit) != 0) return nullptr;
  const auto seconds = static_cast<std::uint32_t>(place.timeout_ms / 1000);
  const auto micros = static_cast<std::uint32_t>(place.timeout_ms % 1000) * 1000;
  modbus_set_response_timeout(context.get(), seconds, micros);
  modbus_set_byte_timeout(context.get(), seconds, micros);
  return context;
}

}  // namespace

tl::expected<std::unique_ptr<Transport>, DeviceError> open_transport(const std::string& url) {
  if (url.rfind("usb:", 0) == 0) return open_usb_transport(url);
  const auto failed = [&](Kind kind, std::string cause, std::string remedy) {
    return tl::unexpected(
        DeviceError{kind, "connect", url, std::move(cause), "its state unknown and untouched", std::move(remedy)});
  };
  auto place = parse_modbus_url(url);
  if (!place)
    return failed(
        Kind::refused, place.error(),
        "write modbus-tcp://HOST[:PORT][?unit=N] or modbus-rtu:/dev/ttyX[?baud=N&parity=N|E|O&stop=1|2&unit=N]");
  Context context = make_context(*place);
  if (!context)
    return failed(Kind::system, "libmodbus refused the settings: " + std::string(modbus_strerror(errno)), "");
  auto transport = std::make_unique<ModbusTransport>(url, std::move(*place), std::move(context));
  if (auto connected = transport->reconnect(); !connected)
    return failed(connected.error().kind == Kind::lost ? Kind::not_found : connected.error().kind,
                  connected.error().cause, "check that the controller is on and the address is right");
  return transport;
}

}  // namespace celadon
