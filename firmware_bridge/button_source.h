#pragma once
// A button that is wired to this computer: a key of a Linux input device, or a GPIO line. The controller's own button
// is the controller's (PROTOCOL.md).

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <tl/expected.hpp>

namespace celadon {

/// The contact took that level, by the kernel's stamp (CLOCK_MONOTONIC).
struct ButtonEdge {
  bool down = false;
  std::int64_t time_ns = 0;
};

struct ButtonError {
  std::string message;         ///< one sentence: button, cause, remedy
  bool wrong_address = false;  ///< trying again cannot help
};

/// One contact, open. Used by one thread; no call waits. Closed when destroyed.
class ButtonSource {
 public:
  virtual ~ButtonSource() = default;
  /// Its level when it was opened.
  virtual bool down_at_open() const = 0;
  /// Appends the edges since the last call, oldest first. An error: it is gone and has to be opened again.
  virtual tl::expected<void, ButtonError> read(std::vector<ButtonEdge>& edges) = 0;
};

/// "evdev:/dev/input/PATH[:KEY]": that key by its kernel's name (KEY_PROG1, BTN_0), or any key of the device, which is
/// taken for this program alone. "gpio:CHIP:LINE[?active=high|low]": chip by name, number, label or path, line by
/// number or name; the line is pulled to its inactive level where the chip can; default: low, a contact to ground.
tl::expected<std::unique_ptr<ButtonSource>, ButtonError> open_button(const std::string& url);

/// Whether the address makes sense, without looking for the device.
tl::expected<void, ButtonError> check_button_url(const std::string& url);

}  // namespace celadon
