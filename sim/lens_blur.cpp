#include "sim/lens_blur.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace celadon::sim {

LensBlur::LensBlur(double blur_px, int samples)
    : samples_(samples), margin_(static_cast<int>(std::ceil(4 * blur_px)) + 1) {
  const double sigma = std::max(blur_px, 0.1) * samples;
  taps_.resize(2 * static_cast<std::size_t>(std::ceil(4 * sigma)) + 1);
  float total = 0;
  for (std::size_t k = 0; k < taps_.size(); ++k) {
    const double u = static_cast<double>(k) - static_cast<double>(taps_.size() / 2);
    taps_[k] = static_cast<float>(std::exp(-u * u / (2 * sigma * sigma)));
    total += taps_[k];
  }
  for (float& tap : taps_) tap /= total;
}

// Only what becomes a pixel is summed: its middle sample.
void LensBlur::apply(const std::vector<float>& fine, const Patch& patch, int columns, std::vector<float>& levels) {
  const int wide = patch.width(), high = patch.height(), half = static_cast<int>(taps_.size()) / 2;
  const auto sum_about = [&](const float* line, int count, std::ptrdiff_t step, int middle) {
    float sum = 0;
    for (int k = -half; k <= half; ++k) {
      sum += taps_[static_cast<std::size_t>(k + half)] * line[std::clamp(middle + k, 0, count - 1) * step];
    }
    return sum;
  };
  lines_.resize(static_cast<std::size_t>(wide) * static_cast<std::size_t>(high * samples_));
  for (int j = 0; j < high * samples_; ++j) {
    const float* const line = &fine[static_cast<std::size_t>(j * wide * samples_)];
    for (int x = 0; x < wide; ++x) {
      lines_[static_cast<std::size_t>(j * wide + x)] = sum_about(line, wide * samples_, 1, x * samples_ + samples_ / 2);
    }
  }
  for (int y = 0; y < high; ++y) {
    for (int x = 0; x < wide; ++x) {
      levels[static_cast<std::size_t>((patch.y0 + y) * columns + patch.x0 + x)] =
          sum_about(&lines_[static_cast<std::size_t>(x)], high * samples_, wide, y * samples_ + samples_ / 2);
    }
  }
}

}  // namespace celadon::sim
