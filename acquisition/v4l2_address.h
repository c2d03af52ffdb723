#pragma once
// The address of a V4L2 camera: which one, and what it shall deliver.

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/frame.h"
#include "acquisition/v4l2_controls.h"

namespace celadon {

/// "/dev/video0?width=1280&height=1024&format=GREY&gain=32": what is no size and no format is a control of the camera,
/// by its key. "serial=CAM001?width=..." names a camera on USB by its serial number, whatever its node.
struct V4l2Address {
  std::string path;    ///< empty: by the serial number
  std::string serial;  ///< empty: by the path
  std::optional<std::uint32_t> width, height, fourcc;
  std::vector<ControlSetting> controls;
};

/// An error names the option that is not understood.
tl::expected<V4l2Address, CameraError> parse_v4l2_address(const std::string& text);

/// The format to take of those that a camera delivers; nothing if it cannot be scanned with. First those of monochrome
/// sensors, where every pixel sees the laser; of colour sensors those with a luma for each pixel, the fewest bytes
/// first; then mosaics; compressed pictures last.
std::optional<std::uint32_t> preferred_fourcc(std::span<const std::uint32_t> delivered);
/// Frames of that format can be scanned with.
bool usable_fourcc(std::uint32_t fourcc);

/// "GREY", "Y10"; "?" for what cannot be printed.
std::string fourcc_text(std::uint32_t fourcc);
/// "GREY, Y10, ...": those that can be scanned with, the better one first.
std::string usable_formats();

}  // namespace celadon
