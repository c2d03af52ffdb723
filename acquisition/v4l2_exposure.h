#pragma once
// The exposure controls of a V4L2 device: set by name, read back, put back as they were found.

#include <cstdint>
#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/frame.h"

namespace celadon {

class V4l2Exposure {
 public:
  /// @param fd  of the device; must stay open until restore()
  V4l2Exposure(int fd, std::string device) : fd_(fd), device_(std::move(device)) {}

  /// The exposure in force; 0 where the device does not tell, or sets it automatically.
  std::int64_t in_force_ns() const;
  /// Turns the automatic off, sets the time (the device's unit is 100 us, clamped to its range) and reads it back.
  tl::expected<std::int64_t, CameraError> set(std::int64_t exposure_ns);
  /// Puts both controls back as they were before the first set(). Tried even when one fails.
  /// @returns whether there was a set()
  bool restore() noexcept;

 private:
  int fd_;
  std::string device_;
  bool touched_ = false;
  std::optional<std::int32_t> found_auto_, found_time_;  ///< before the first set(); none: could not be read
};

}  // namespace celadon
