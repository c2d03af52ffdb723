#pragma once
// Grey images from files: binary PGM and PNG.

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

namespace celadon {

/// Which channel of a colour image becomes its grey value. Luma: (77 R + 150 G + 29 B + 128) / 256.
enum class ColourChannel : std::uint8_t { red, green, luma };

/// 8 bit grey, rows without padding.
struct GreyImage {
  int width_px = 0, height_px = 0;
  std::vector<std::uint8_t> bytes;
};

/// One sentence that names the file, what is wrong with it and the remedy; errno_value where the system refused.
struct ImageError {
  std::string message;
  int errno_value = 0;
};

/// Reads a binary PGM with maximum 255, or a PNG: grey or palette of at most 8 bits a sample, or 8 bit colour; alpha is
/// passed over, and values are taken as stored (no gamma). At most 65535 x 65535 and 256 million pixels.
/// @param image  its memory is reused
tl::expected<void, ImageError> read_image(const std::filesystem::path& file, ColourChannel channel, GreyImage& image);

/// Writes a binary PGM.
/// @pre bytes holds height rows of width bytes, stride_bytes apart
tl::expected<void, ImageError> write_pgm(const std::filesystem::path& file, int width_px, int height_px,
                                         std::size_t stride_bytes, std::span<const std::uint8_t> bytes);

/// All bytes of a file, refused when longer than `largest`.
tl::expected<std::vector<std::uint8_t>, ImageError> read_bytes(const std::filesystem::path& file, std::size_t largest);

}  // namespace celadon
