#include "acquisition/stereo/normal_pictures.h"

#include <cmath>
#include <limits>

namespace celadon {
namespace {

constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();

}  // namespace

std::array<float, 4> cubic_weights(float t) {
  const float t2 = t * t, t3 = t2 * t;
  return {-0.5F * t + t2 - 0.5F * t3, 1 - 2.5F * t2 + 1.5F * t3, 0.5F * t + 2 * t2 - 1.5F * t3, -0.5F * t2 + 0.5F * t3};
}

std::array<float, 4> cubic_slopes(float t) {
  const float t2 = t * t;
  return {-0.5F + 2 * t - 1.5F * t2, -5 * t + 4.5F * t2, 0.5F + 4 * t - 4.5F * t2, -t + 1.5F * t2};
}

LevelPicture levels_of(const CameraMode& mode, std::span<const std::uint8_t> bytes) {
  const int saturated = mode.saturated_from();
  const std::size_t step = bytes_per_pixel(mode.format);
  LevelPicture out{mode.width_px, mode.height_px, {}};
  out.level.reserve(static_cast<std::size_t>(mode.width_px) * static_cast<std::size_t>(mode.height_px));
  for (int y = 0; y < mode.height_px; ++y) {
    const std::uint8_t* const row = bytes.data() + static_cast<std::size_t>(y) * mode.stride_bytes;
    for (std::size_t x = 0; x < static_cast<std::size_t>(mode.width_px); ++x) {
      const int level = row[x * step];
      out.level.push_back(level >= saturated ? kUnknown : static_cast<float>(level));
    }
  }
  return out;
}

LevelPicture normal_picture(const NormalPair& pair, std::size_t picture, const LevelPicture& seen) {
  LevelPicture out{pair.width_px(), pair.height_px(), {}};
  out.level.reserve(static_cast<std::size_t>(out.width_px) * static_cast<std::size_t>(out.height_px));
  for (int y = 0; y < out.height_px; ++y) {
    for (int x = 0; x < out.width_px; ++x) {
      const Eigen::Vector2d at = pair.pixel(picture, x, y);
      if (!(at.x() >= 1 && at.y() >= 1 && at.x() < seen.width_px - 2 && at.y() < seen.height_px - 2)) {
        out.level.push_back(kUnknown);
        continue;
      }
      const double left = std::floor(at.x()), above = std::floor(at.y());
      const auto across = cubic_weights(static_cast<float>(at.x() - left)),
                 down = cubic_weights(static_cast<float>(at.y() - above));
      float level = 0;
      for (int j = 0; j < 4; ++j) {
        const float* const row = seen.row(static_cast<int>(above) - 1 + j) + static_cast<int>(left) - 1;
        level += down[static_cast<std::size_t>(j)] *
                 (across[0] * row[0] + across[1] * row[1] + across[2] * row[2] + across[3] * row[3]);
      }
      out.level.push_back(level);
    }
  }
  return out;
}

}  // namespace celadon
