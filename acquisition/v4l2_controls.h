#pragma once
// Controls of a V4L2 device: listed, set by name and read back, put back as they were found.

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/frame.h"

namespace celadon {

struct V4l2Control {
  std::string name;  ///< as the driver writes it, "White Balance, Automatic"
  std::uint32_t id = 0;
  std::int64_t minimum = 0, maximum = 0, step = 1, standard = 0;
  std::optional<std::int64_t> value;  ///< none: it cannot be read
  bool inactive = false;              ///< another control holds it, as the automatic does the exposure
  bool read_only = false;
  std::vector<std::string> menu;  ///< its choices by value; empty strings where there is none

  /// "white_balance_automatic": lower case, one underscore for whatever is no letter or digit.
  std::string key() const;
};

/// Numbers, switches and menus of an open device.
std::vector<V4l2Control> list_v4l2_controls(int fd);

/// A control's key, and the value it shall have.
using ControlSetting = std::pair<std::string, std::int64_t>;

class V4l2Controls {
 public:
  /// @param fd  of the device; must stay open until restore()
  V4l2Controls(int fd, std::string device) : fd_(fd), device_(std::move(device)) {}

  /// Switches off what changes pictures by itself (white balance, gain, focus, brightness, hue, the frame rate in the
  /// dark; exposure is V4l2Exposure's), then gives the named controls their values, in their order. A control that is
  /// named is left to who named it. Errors name the control, its range or errno, and the remedy.
  tl::expected<void, CameraError> apply(std::span<const ControlSetting> settings);
  /// Puts all back as they were, the last one set first. Tried even when one fails.
  void restore() noexcept;

 private:
  tl::expected<void, CameraError> set(const V4l2Control& control, std::int64_t value);

  int fd_;
  std::string device_;
  std::vector<std::pair<std::uint32_t, std::int32_t>> found_;  ///< what was changed, in that order
};

}  // namespace celadon
