#pragma once
// Names that V4L2 drivers give.

#include <cstdint>
#include <filesystem>
#include <string>

namespace celadon {

/// Text up to its end or `size`; "?" for what is not printable ASCII.
std::string printable(const std::uint8_t* text, std::size_t size);

/// Serial number of the USB device behind a video node, or "".
/// @param path  "/dev/video0", or a link to it
std::string usb_serial_of(const std::string& path);
/// @param node  its folder, "/sys/class/video4linux/video0"
std::string usb_serial_at(const std::filesystem::path& node);

}  // namespace celadon
