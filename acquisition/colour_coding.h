#pragma once
// How a camera delivers the colours of its pixels beside their luma.

#include <cstddef>
#include <cstdint>

namespace celadon {

/// Where the colours of a frame lie.
enum class ColourLayout : std::uint8_t {
  none,      ///< a grey picture
  yuyv,      ///< in Frame::bytes() themselves: Y0 U Y1 V
  uv_pairs,  ///< in Frame::colour(): U V for two pixels of a row
  uv_cells,  ///< in Frame::colour(): U V for a cell of 2 x 2 pixels, as NV12 has them
  bggr,      ///< in Frame::colour(): the mosaic of the sensor, named by its first two rows
  gbrg,
  grbg,
  rggb
};

/// Weights of red and blue in luma: ITU-R BT.601 (0.299, 0.114) or BT.709 (0.2126, 0.0722).
enum class LumaWeights : std::uint8_t { bt601, bt709 };

/// What the numbers mean, and how far apart rows lie.
struct ColourCoding {
  ColourLayout layout = ColourLayout::none;
  std::size_t stride_bytes = 0;  ///< of Frame::colour()
  LumaWeights weights = LumaWeights::bt601;
  bool limited_range = false;  ///< Y from 16 to 235, U and V from 16 to 240; else all from 0 to 255
  bool operator==(const ColourCoding&) const = default;
};

inline bool is_mosaic(ColourLayout layout) {
  return layout >= ColourLayout::bggr;
}

/// Red, green and blue of a pixel, 0 to 255 where the camera's are, beyond where rounding or the camera leaves that.
struct LinearColour {
  float red = 0, green = 0, blue = 0;
};
/// The definition of Y, U and V solved for the colours: Y = r R + g G + b B, U = (B - Y) / (2 - 2 b) + 128,
/// V = (R - Y) / (2 - 2 r) + 128, ranges widened first.
/// @pre coding is not that of a mosaic
LinearColour colour_of(const ColourCoding& coding, float y, float u, float v);

}  // namespace celadon
