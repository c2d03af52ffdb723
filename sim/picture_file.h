#pragma once
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/frame.h"

namespace celadon::sim {

/// Writes a frame (rows without padding) as an 8-bit grey picture: PNG if the name ends in .png, else binary PGM. Of
/// YUYV the luma. @returns one sentence with file and cause if it fails; nothing is left under the name then
tl::expected<void, std::string> write_picture(const std::filesystem::path& file, int width_px, int height_px,
                                              PixelFormat format, std::span<const std::uint8_t> bytes);

}  // namespace celadon::sim
