#include "acquisition/stereo/picture_noise.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "acquisition/stereo/normal_pictures.h"

namespace celadon {

PictureNoise noise_of(const CameraMode& mode, std::span<const std::vector<std::uint8_t>> pictures) {
  constexpr double kRounding = 1. / 12;
  constexpr std::size_t kBins = 64;
  std::vector<LevelPicture> levels;
  for (const auto& picture : pictures) levels.push_back(levels_of(mode, picture));
  struct Bin {
    double count = 0, mean = 0, variance = 0;
  };
  std::array<Bin, kBins> bins{};
  const auto n = static_cast<double>(levels.size());
  for (std::size_t i = 0; i < levels.front().level.size(); ++i) {
    double sum = 0, square = 0;
    for (const LevelPicture& picture : levels) {
      const double level = picture.level[i];
      sum += level;
      square += level * level;
    }
    if (std::isnan(sum)) continue;
    const double mean = sum / n;
    Bin& bin = bins[std::min(static_cast<std::size_t>(mean * kBins / 256), kBins - 1)];
    ++bin.count;
    bin.mean += mean;
    bin.variance += (square - n * mean * mean) / (n - 1);
  }
  // The variance of a variance goes as its square.
  double w = 0, wx = 0, wy = 0, wxx = 0, wxy = 0;
  for (const Bin& bin : bins) {
    if (bin.count < 2) continue;
    const double x = bin.mean / bin.count, y = std::max(bin.variance / bin.count, kRounding);
    const double weight = bin.count / (y * y);
    w += weight, wx += weight * x, wy += weight * y, wxx += weight * x * x, wxy += weight * x * y;
  }
  const double determinant = w * wxx - wx * wx;
  const double slope = determinant > 1e-9 * w * wxx ? std::max(0., (w * wxy - wx * wy) / determinant) : 0;
  return {w > 0 ? std::max(kRounding, (wy - slope * wx) / w) : kRounding, slope};
}

}  // namespace celadon
