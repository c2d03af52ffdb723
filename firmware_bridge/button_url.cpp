#include "firmware_bridge/button_url.h"

#include <libevdev/libevdev.h>

#include <string_view>

#include "firmware_bridge/button_open.h"

namespace celadon {
namespace {

constexpr std::string_view kEvdev = "evdev:", kGpio = "gpio:", kActive = "active=";

bool names_a_key(std::string_view text) {
  return text.substr(0, 4) == "KEY_" || text.substr(0, 4) == "BTN_";
}

tl::unexpected<std::string> wrong(std::initializer_list<std::string_view> parts) {
  std::string text;
  for (const std::string_view part : parts) text += part;
  return tl::unexpected(std::move(text));
}

tl::expected<ButtonPlace, std::string> parse_evdev(std::string_view rest) {
  EvdevPlace place;
  // Names below /dev/input/by-path have colons of their own.
  if (const std::size_t colon = rest.rfind(':'); colon != rest.npos && names_a_key(rest.substr(colon + 1))) {
    const std::string key(rest.substr(colon + 1));
    place.key = libevdev_event_code_from_name(EV_KEY, key.c_str());
    if (place.key < 0) return wrong({"no key has the name ", key, " (evtest and input-event-codes.h name them)"});
    rest = rest.substr(0, colon);
  }
  if (rest.empty() || rest.front() != '/')
    return wrong({"\"", rest, "\" is not the path of an input device, such as /dev/input/by-id/NAME"});
  place.path = rest;
  return place;
}

tl::expected<ButtonPlace, std::string> parse_gpio(std::string_view rest) {
  GpioPlace place;
  if (const std::size_t question = rest.find('?'); question != rest.npos) {
    const std::string_view option = rest.substr(question + 1);
    const bool known = option.substr(0, kActive.size()) == kActive;
    const std::string_view level = known ? option.substr(kActive.size()) : std::string_view();
    if (level != "low" && level != "high") return wrong({"\"", option, "\" is not active=low or active=high"});
    place.active_low = level == "low";
    rest = rest.substr(0, question);
  }
  const std::size_t colon = rest.find(':');
  if (colon == rest.npos || colon == 0 || colon + 1 == rest.size())
    return wrong({"\"", rest, "\" is not CHIP:LINE, such as gpiochip0:17"});
  place.chip = rest.substr(0, colon);
  place.line = rest.substr(colon + 1);
  return place;
}

}  // namespace

tl::expected<ButtonPlace, std::string> parse_button_url(const std::string& url) {
  const std::string_view text = url;
  if (text.substr(0, kEvdev.size()) == kEvdev) return parse_evdev(text.substr(kEvdev.size()));
  if (text.substr(0, kGpio.size()) == kGpio) return parse_gpio(text.substr(kGpio.size()));
  return wrong({"it begins with neither evdev: nor gpio:"});
}

tl::expected<void, ButtonError> check_button_url(const std::string& url) {
  const auto place = parse_button_url(url);
  if (place) return {};
  return tl::unexpected(ButtonError{"The button is '" + url + "': " + place.error() +
                                        "; give evdev:/dev/input/PATH[:KEY] or gpio:CHIP:LINE[?active=high|low].",
                                    true});
}

tl::expected<std::unique_ptr<ButtonSource>, ButtonError> open_button(const std::string& url) {
  if (auto checked = check_button_url(url); !checked) return tl::unexpected(checked.error());
  const ButtonPlace place = *parse_button_url(url);
  if (const auto* evdev = std::get_if<EvdevPlace>(&place)) return open_evdev_button(url, *evdev);
  return open_gpio_button(url, std::get<GpioPlace>(place));
}

}  // namespace celadon
