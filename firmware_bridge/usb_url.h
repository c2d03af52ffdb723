#pragma once
// Which USB controller is meant, from its URL.

#include <cstdint>
#include <optional>
#include <string>

#include <tl/expected.hpp>

namespace celadon {

struct UsbPlace {
  struct Pair {
    std::uint16_t vendor = 0, product = 0;
  };
  std::optional<Pair> pair;  ///< none: any
  std::string serial;        ///< empty: any
  int timeout_ms = 500;
};

/// Parses "usb:[VID:PID][/SERIAL]" or "usb:SERIAL", with "?timeout_ms=N"; the error is one clause that names the part
/// and what is allowed there.
tl::expected<UsbPlace, std::string> parse_usb_url(const std::string& url);

}  // namespace celadon
