#pragma once
// The address of a V4L2 camera: device node, and what it shall deliver.

#include <cstdint>
#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/frame.h"

namespace celadon {

/// "/dev/video0?width=1280&height=1024&format=GREY".
struct V4l2Address {
  std::string path;
  std::optional<std::uint32_t> width, height, fourcc;
};

/// An error names the option that is not understood.
tl::expected<V4l2Address, CameraError> parse_v4l2_address(const std::string& text);

/// "GREY"; "?" for what cannot be printed.
std::string fourcc_text(std::uint32_t fourcc);

}  // namespace celadon
