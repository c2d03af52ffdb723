#include "acquisition/calibrate/board_picture.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <vector>

namespace celadon {
namespace {

constexpr double kRounding = 0.28867513459481287;  // of a uniform error of one level
constexpr double kMaskNorm = 6;                    // root of the sum of the mask's squares
constexpr double kNormalMedian = 0.6744897501960817;
constexpr std::size_t kEnoughPixels = 200;

constexpr double kLeastContrast = 25;  // between the dark and the bright hundredth, levels
constexpr double kWidestEdge_px = 3.5;

// Level below which that share of the counted values lies.
template <std::size_t N>
double quantile(const std::array<std::size_t, N>& counts, double share) {
  std::size_t total = 0;
  for (const std::size_t n : counts) total += n;
  const double wanted = share * static_cast<double>(total);
  double seen = 0;
  for (std::size_t i = 0; i < N; ++i) {
    seen += static_cast<double>(counts[i]);
    if (seen >= wanted && counts[i] > 0) return static_cast<double>(i);
  }
  return static_cast<double>(N - 1);
}

std::string with_numbers(const char* format, double a, double b) {
  char text[240];
  std::snprintf(text, sizeof text, format, a, b);
  return text;
}

}  // namespace

bool GreyView::holds(const Eigen::Vector2d& p, double radius) const {
  return p.x() >= radius && p.y() >= radius && p.x() <= width_px - 1 - radius && p.y() <= height_px - 1 - radius;
}

double GreyView::mean_about(const Eigen::Vector2d& p) const {
  const int x = static_cast<int>(std::lround(p.x())), y = static_cast<int>(std::lround(p.y()));
  double sum = 0;
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) sum += at(x + dx, y + dy);
  }
  return sum / 9;
}

PictureNoise::PictureNoise(const GreyView& picture) {
  // |mask| is a whole number up to 2040.
  std::vector<std::array<std::size_t, 2048>> counts(kBins);
  std::array<std::size_t, 2048> all{};
  std::array<std::size_t, kBins> in_bin{};
  for (int y = 1; y + 1 < picture.height_px; ++y) {
    for (int x = 1; x + 1 < picture.width_px; ++x) {
      const double corners =
          picture.at(x - 1, y - 1) + picture.at(x + 1, y - 1) + picture.at(x - 1, y + 1) + picture.at(x + 1, y + 1);
      const double sides = picture.at(x, y - 1) + picture.at(x, y + 1) + picture.at(x - 1, y) + picture.at(x + 1, y);
      const double middle = picture.at(x, y);
      const auto size = static_cast<std::size_t>(std::lround(std::abs(corners - 2 * sides + 4 * middle)));
      const auto bin =
          std::min<std::size_t>(static_cast<std::size_t>((corners + sides + middle) / 9 * kBins / 256), kBins - 1);
      ++counts[bin][size];
      ++in_bin[bin];
      ++all[size];
    }
  }
  const auto sigma_of = [](const std::array<std::size_t, 2048>& histogram) {
    return std::max(kRounding, quantile(histogram, 0.5) / (kNormalMedian * kMaskNorm));
  };
  const double overall = sigma_of(all);
  for (std::size_t i = 0; i < kBins; ++i) sigma_[i] = in_bin[i] >= kEnoughPixels ? sigma_of(counts[i]) : overall;
}

double PictureNoise::sigma(double level) const {
  // Between the middles of two bins.
  const double at = std::clamp(level * kBins / 256 - 0.5, 0.0, kBins - 1.0);
  const auto below = static_cast<std::size_t>(at), above = std::min<std::size_t>(below + 1, kBins - 1);
  const double share = at - static_cast<double>(below);
  return (1 - share) * sigma_[below] + share * sigma_[above];
}

std::string picture_problem(const GreyView& picture) {
  std::array<std::size_t, 256> levels{};
  for (const std::uint8_t byte : picture.bytes) ++levels[byte];
  const double dark = quantile(levels, 0.01), bright = quantile(levels, 0.99);
  if (bright - dark < kLeastContrast) {
    return bright < 128 ? with_numbers(
                              "the picture is too dark: its brightest hundredth begins at level %.0f of 255, its "
                              "darkest ends at %.0f; give more light or a longer exposure",
                              bright, dark)
                        : with_numbers(
                              "the picture has no contrast: nearly all of it lies between levels %.0f and %.0f; "
                              "shorten the exposure until the board's black is dark",
                              dark, bright);
  }
  if (dark > 200) {
    return with_numbers(
        "the picture is overexposed: all but a hundredth of it is above level %.0f of %.0f; shorten "
        "the exposure",
        dark, 255);
  }
  // The steepest slope of an edge blurred by s is contrast / (s sqrt(2 pi)); central differences of averages of three
  // keep noise from counting as one.
  std::array<std::size_t, 1024> slopes{};
  for (int y = 1; y + 1 < picture.height_px; ++y) {
    for (int x = 2; x + 2 < picture.width_px; ++x) {
      double across = 0, along = 0;
      for (int k = -1; k <= 1; ++k) {
        across += picture.at(x + 1, y + k) - picture.at(x - 1, y + k);
        along += picture.at(x + k, y + 1) - picture.at(x + k, y - 1);
      }
      const double slope = std::hypot(across, along) / 6;
      ++slopes[std::min<std::size_t>(static_cast<std::size_t>(slope * 4), 1023)];
    }
  }
  const double steepest = (quantile(slopes, 0.999) + 0.5) / 4;
  const double width = (bright - dark) / (steepest * std::sqrt(2 * std::numbers::pi));
  if (width > kWidestEdge_px) {
    return with_numbers(
        "the picture is blurred or shows no board: its sharpest edges are %.1f pixels wide (standard "
        "deviation; at most %.1f); hold the board still in the picture and focus the lens",
        width, kWidestEdge_px);
  }
  return {};
}

}  // namespace celadon
