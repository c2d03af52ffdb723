#include "firmware_bridge/modbus_url.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <initializer_list>
#include <optional>
#include <string_view>

namespace celadon {
namespace {

// Those that termios and libmodbus both know; libmodbus silently takes 9600 for any other.
constexpr std::array kBaudRates = {1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 500000, 921600};

std::optional<int> whole_number(std::string_view text, int lowest, int highest) {
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || value < lowest || value > highest) return {};
  return value;
}

// Joined by appending: g++ 12 sees a false overlap in "literal" + temporary.
std::string join(std::initializer_list<std::string_view> parts) {
  std::string text;
  for (const std::string_view part : parts) text += part;
  return text;
}

std::string bad_value(std::string_view key, std::string_view value, std::string_view allowed) {
  return join({key, "=", value, " is not ", allowed});
}

// One "key=value" of the query; the returned text is empty if it was taken.
std::string take_option(ModbusPlace& place, std::string_view key, std::string_view value) {
  auto* rtu = std::get_if<ModbusRtuPlace>(&place.link);
  const auto number = [&](int& to, int lowest, int highest) -> std::string {
    const std::optional<int> n = whole_number(value, lowest, highest);
    if (!n)
      return bad_value(key, value, "a whole number from " + std::to_string(lowest) + " to " + std::to_string(highest));
    to = *n;
    return {};
  };
  if (key == "unit") return rtu ? number(place.unit, 1, 247) : number(place.unit, 0, 255);
  if (key == "timeout_ms") return number(place.timeout_ms, 10, 60000);
  if (rtu && key == "baud") {
    const std::optional<int> n = whole_number(value, 1, 1 << 30);
    if (!n || std::find(kBaudRates.begin(), kBaudRates.end(), *n) == kBaudRates.end())
      return bad_value(key, value, "a baud rate of 1200, 2400, ... 115200, ... 921600");
    rtu->baud = *n;
    return {};
  }
  if (rtu && key == "parity") {
    if (value != "N" && value != "E" && value != "O") return bad_value(key, value, "N, E or O");
    rtu->parity = value[0];
    return {};
  }
  if (rtu && key == "stop") return number(rtu->stop_bits, 1, 2);
  if (rtu && key == "rs485") {
    if (value != "0" && value != "1") return bad_value(key, value, "0 or 1");
    rtu->rs485 = value == "1";
    return {};
  }
  return "\"" + std::string(key) +
         "\" is no option here (known: " + (rtu ? "baud, parity, stop, unit, rs485, timeout_ms)" : "unit, timeout_ms)");
}

tl::expected<ModbusTcpPlace, std::string> parse_host(std::string_view text) {
  ModbusTcpPlace place;
  std::string_view port;
  if (!text.empty() && text[0] == '[') {
    const std::size_t close = text.find(']');
    if (close == std::string_view::npos)
      return tl::unexpected(std::string("the bracket of the IPv6 address is not closed"));
    place.host = text.substr(1, close - 1);
    port = text.substr(close + 1);
    if (!port.empty() && port[0] != ':') return tl::unexpected(std::string("only :PORT may follow the IPv6 address"));
  } else {
    const std::size_t colon = text.find(':');
    place.host = text.substr(0, colon);
    if (colon != std::string_view::npos) port = text.substr(colon);
  }
  if (place.host.empty()) return tl::unexpected(std::string("the host is missing"));
  if (!port.empty()) {
    const std::optional<int> n = whole_number(port.substr(1), 1, 65535);
    if (!n) return tl::unexpected(join({"port \"", port.substr(1), "\" is not a number from 1 to 65535"}));
    place.port = *n;
  }
  return place;
}

}  // namespace

tl::expected<ModbusPlace, std::string> parse_modbus_url(const std::string& url) {
  constexpr std::string_view kTcp = "modbus-tcp://", kRtu = "modbus-rtu:";
  ModbusPlace place;
  std::string_view rest = url;
  const std::size_t question = rest.find('?');
  std::string_view query = question == std::string_view::npos ? std::string_view() : rest.substr(question + 1);
  rest = rest.substr(0, question);
  if (rest.substr(0, kTcp.size()) == kTcp) {
    auto host = parse_host(rest.substr(kTcp.size()));
    if (!host) return tl::unexpected(std::move(host.error()));
    place.link = std::move(*host);
  } else if (rest.substr(0, kRtu.size()) == kRtu) {
    ModbusRtuPlace rtu;
    rtu.device = rest.substr(kRtu.size());
    if (rtu.device.empty()) return tl::unexpected(std::string("the serial device is missing"));
    place.link = std::move(rtu);
    place.unit = 1;
  } else {
    return tl::unexpected(std::string("it begins neither with modbus-tcp:// nor with modbus-rtu:"));
  }
  while (!query.empty()) {
    const std::size_t end = query.find('&');
    const std::string_view option = query.substr(0, end);
    query = end == std::string_view::npos ? std::string_view() : query.substr(end + 1);
    const std::size_t equals = option.find('=');
    if (equals == std::string_view::npos) return tl::unexpected(join({"\"", option, "\" is not KEY=VALUE"}));
    std::string problem = take_option(place, option.substr(0, equals), option.substr(equals + 1));
    if (!problem.empty()) return tl::unexpected(std::move(problem));
  }
  return place;
}

}  // namespace celadon
