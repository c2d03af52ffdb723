#pragma once
// How much the grey levels of a camera scatter, from pictures of something that stands still.

#include <cstdint>
#include <span>
#include <vector>

#include "acquisition/frame.h"

namespace celadon {

/// Variance of a grey level: read noise and shot noise.
struct PictureNoise {
  double read_variance = 0;       ///< levels^2
  double variance_per_level = 0;  ///< levels: one over the electrons of a level
  double variance(double level) const { return read_variance + variance_per_level * (level > 0 ? level : 0); }
};

/// Photon transfer: variance against mean of each pixel over the pictures, a line through them by weighted least
/// squares, neither part below what rounding to whole levels makes (1/12) and 0. Saturated pixels do not count.
/// @pre two pictures or more, each a whole frame of this mode
PictureNoise noise_of(const CameraMode& mode, std::span<const std::vector<std::uint8_t>> pictures);

}  // namespace celadon
