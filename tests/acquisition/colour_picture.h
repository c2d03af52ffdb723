#pragma once
// Pictures whose colours are a function of the place, in every layout that cameras deliver; coded by the definition of
// Y, U and V.

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <vector>

#include "acquisition/frame.h"

namespace celadon::testing {

using Rgb = std::array<double, 3>;

struct ColourPicture {
  CameraMode mode;
  std::vector<std::uint8_t> bytes, colour;
  /// A frame on it; it must stay.
  Frame frame(FrameReturn& owner) const { return Frame(&owner, 0, bytes, {}, colour); }
};

class NobodyReturns final : public FrameReturn {
 public:
  void give_back(std::uint32_t) noexcept override {}
};

/// Y, U, V of a colour, as ITU-R BT.601 and BT.709 define them.
inline std::array<double, 3> yuv_of(const Rgb& c, LumaWeights weights, bool limited) {
  const double kr = weights == LumaWeights::bt601 ? 0.299 : 0.2126, kb = weights == LumaWeights::bt601 ? 0.114 : 0.0722;
  const double y = kr * c[0] + (1 - kr - kb) * c[1] + kb * c[2];
  const double u = (c[2] - y) / (2 * (1 - kb)), v = (c[0] - y) / (2 * (1 - kr));
  if (limited) return {16 + y * 219 / 255, 128 + u * 224 / 255, 128 + v * 224 / 255};
  return {y, 128 + u, 128 + v};
}

inline std::uint8_t to_level(double value) {
  return static_cast<std::uint8_t>(std::lround(std::clamp(value, 0., 255.)));
}

/// @pre width and height are even
inline ColourPicture picture_of(int width, int height, ColourCoding coding,
                                const std::function<Rgb(double x, double y)>& colour_at) {
  ColourPicture out;
  out.mode.width_px = width;
  out.mode.height_px = height;
  const bool packed = coding.layout == ColourLayout::yuyv;
  out.mode.format = packed ? PixelFormat::yuyv : PixelFormat::grey8;
  const std::size_t padding = 6;  // of each row
  out.mode.stride_bytes = static_cast<std::size_t>(width) * (packed ? 2 : 1) + padding;
  coding.stride_bytes = static_cast<std::size_t>(width) + 10;
  out.mode.colour = coding;
  out.mode.saturated_level = coding.limited_range ? 235 : 250;
  out.bytes.assign(out.mode.stride_bytes * static_cast<std::size_t>(height), 77);
  out.colour.assign(packed ? 0 : coding.stride_bytes * static_cast<std::size_t>(height), 77);
  const char* const mosaics[] = {"BGGR", "GBRG", "GRBG", "RGGB"};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      std::uint8_t* const row = &out.bytes[static_cast<std::size_t>(y) * out.mode.stride_bytes];
      const auto yuv = yuv_of(colour_at(x, y), coding.weights, coding.limited_range);
      row[packed ? 2 * x : x] = to_level(yuv[0]);
      if (is_mosaic(coding.layout)) {
        const char c =
            mosaics[static_cast<int>(coding.layout) - static_cast<int>(ColourLayout::bggr)][2 * (y % 2) + x % 2];
        out.colour[static_cast<std::size_t>(y) * coding.stride_bytes + static_cast<std::size_t>(x)] =
            to_level(colour_at(x, y)[c == 'R'   ? 0
                                     : c == 'G' ? 1
                                                : 2]);
        continue;
      }
      const bool cells = coding.layout == ColourLayout::uv_cells;
      if (x % 2 != 0 || (cells && y % 2 != 0)) continue;
      // The mean of the pixels that share it.
      std::array<double, 2> uv{};
      const int rows = cells ? 2 : 1;
      for (int dy = 0; dy < rows; ++dy) {
        for (int dx = 0; dx < 2; ++dx) {
          const auto of = yuv_of(colour_at(x + dx, y + dy), coding.weights, coding.limited_range);
          uv[0] += of[1] / (2 * rows);
          uv[1] += of[2] / (2 * rows);
        }
      }
      std::uint8_t* const pair = packed
                                     ? row + 2 * x + 1
                                     : &out.colour[static_cast<std::size_t>(cells ? y / 2 : y) * coding.stride_bytes +
                                                   static_cast<std::size_t>(x)];
      pair[0] = to_level(uv[0]);
      pair[packed ? 2 : 1] = to_level(uv[1]);
    }
  }
  return out;
}

}  // namespace celadon::testing
