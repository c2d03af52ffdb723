#include "firmware_bridge/usb_url.h"

#include <charconv>
#include <string_view>

namespace celadon {
namespace {

constexpr std::size_t kPairLength = 9;  // "1209:0001"

bool parse_hex4(std::string_view text, std::uint16_t& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value, 16);
  return error == std::errc() && end == text.data() + text.size();
}

std::optional<UsbPlace::Pair> parse_pair(std::string_view text) {
  UsbPlace::Pair pair;
  if (text.size() != kPairLength || text[4] != ':' || !parse_hex4(text.substr(0, 4), pair.vendor) ||
      !parse_hex4(text.substr(5), pair.product))
    return std::nullopt;
  return pair;
}

}  // namespace

tl::expected<UsbPlace, std::string> parse_usb_url(const std::string& url) {
  constexpr std::string_view kUsb = "usb:", kTimeout = "timeout_ms=";
  std::string_view rest = url;
  if (rest.substr(0, kUsb.size()) != kUsb) return tl::unexpected(std::string("it does not begin with usb:"));
  rest.remove_prefix(kUsb.size());
  UsbPlace place;
  if (const std::size_t question = rest.find('?'); question != std::string_view::npos) {
    const std::string_view option = rest.substr(question + 1);
    rest = rest.substr(0, question);
    const bool known = option.substr(0, kTimeout.size()) == kTimeout;
    const std::string_view number = known ? option.substr(kTimeout.size()) : std::string_view();
    const auto [end, error] = std::from_chars(number.data(), number.data() + number.size(), place.timeout_ms);
    if (error != std::errc() || end != number.data() + number.size() || place.timeout_ms < 10 ||
        place.timeout_ms > 60000) {
      std::string problem("\"");
      problem.append(option).append("\" is not timeout_ms=N with a whole number from 10 to 60000");
      return tl::unexpected(std::move(problem));
    }
  }
  const std::size_t slash = rest.find('/');
  const std::string_view head = rest.substr(0, slash);
  place.pair = parse_pair(head);
  if (slash == std::string_view::npos) {
    if (!place.pair) place.serial = head;
    return place;
  }
  if (!head.empty() && !place.pair) {
    std::string problem("\"");
    problem.append(head).append("\" is not a VID:PID of four hexadecimal digits each");
    return tl::unexpected(std::move(problem));
  }
  place.serial = rest.substr(slash + 1);
  if (place.serial.empty()) return tl::unexpected(std::string("the serial number after the / is missing"));
  return place;
}

}  // namespace celadon
