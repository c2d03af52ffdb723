#pragma once
// Addresses of buttons taken apart.

#include <string>
#include <variant>

#include <tl/expected.hpp>

namespace celadon {

struct EvdevPlace {
  std::string path;
  int key = -1;  ///< of EV_KEY; -1: any
};
struct GpioPlace {
  std::string chip, line;
  bool active_low = true;
};
using ButtonPlace = std::variant<EvdevPlace, GpioPlace>;

/// As open_button() takes it; an error says what is wrong, without the address.
tl::expected<ButtonPlace, std::string> parse_button_url(const std::string& url);

}  // namespace celadon
