#pragma once
// The two kinds of button that are wired to this computer. `url` names the button in errors.

#include <memory>
#include <string>

#include <tl/expected.hpp>

#include "firmware_bridge/button_source.h"
#include "firmware_bridge/button_url.h"

namespace celadon {

tl::expected<std::unique_ptr<ButtonSource>, ButtonError> open_evdev_button(const std::string& url,
                                                                           const EvdevPlace& place);
tl::expected<std::unique_ptr<ButtonSource>, ButtonError> open_gpio_button(const std::string& url,
                                                                          const GpioPlace& place);

/// "The button URL cannot be used: CAUSE; REMEDY."
inline tl::unexpected<ButtonError> unusable_button(const std::string& url, const std::string& cause,
                                                   const std::string& remedy) {
  return tl::unexpected(ButtonError{"The button " + url + " cannot be used: " + cause + "; " + remedy + ".", false});
}

}  // namespace celadon
