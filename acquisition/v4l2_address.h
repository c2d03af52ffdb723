#pragma once
// The address of a V4L2 camera: device node, and what it shall deliver.

#include <cstdint>
#include <optional>
#include <span>
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

/// The format to take of those that a camera delivers; nothing if it cannot be scanned with. GREY comes from monochrome
/// sensors: every pixel sees the laser and the bus carries half the bytes. YUYV comes from colour sensors, where the
/// laser's own channel is formed from luma and chroma.
std::optional<std::uint32_t> preferred_fourcc(std::span<const std::uint32_t> delivered);
/// Frames of that format can be scanned with.
bool usable_fourcc(std::uint32_t fourcc);

/// "GREY"; "?" for what cannot be printed.
std::string fourcc_text(std::uint32_t fourcc);

}  // namespace celadon
