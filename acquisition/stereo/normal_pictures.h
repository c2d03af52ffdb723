#pragma once
// Pictures resampled to normal images.

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "acquisition/frame.h"
#include "acquisition/stereo/normal_pair.h"

namespace celadon {

/// Grey levels, row by row; NaN where nothing is known: saturated, or outside of what the camera saw.
struct LevelPicture {
  int width_px = 0, height_px = 0;
  std::vector<float> level;
  const float* row(int y) const { return &level[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_px)]; }
};

/// Levels of a camera's frame: grey, or the luma of YUYV. @pre bytes are a whole frame of this mode
LevelPicture levels_of(const CameraMode& mode, std::span<const std::uint8_t> bytes);

/// One of the two normal images (0: first, 1: second), by cubic convolution (Keys 1981, a = -1/2), whose weights are
/// those of each place: OpenCV's remap() rounds places to 1/32 px, more than a match is uncertain by.
LevelPicture normal_picture(const NormalPair& pair, std::size_t picture, const LevelPicture& seen);

/// Weights of the four samples about a place, `t` in [0, 1) beyond the second of them, and their derivatives by t.
std::array<float, 4> cubic_weights(float t);
std::array<float, 4> cubic_slopes(float t);

}  // namespace celadon
