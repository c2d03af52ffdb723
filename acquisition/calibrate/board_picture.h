#pragma once
// A picture of a board as numbers: its grey levels between pixels, its noise, and why nothing was found in it.

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>

namespace celadon {

/// A grey picture that belongs to somebody else. Pixel centres at whole numbers.
struct GreyView {
  std::span<const std::uint8_t> bytes;  ///< row after row
  int width_px = 0, height_px = 0;

  double at(int x, int y) const {
    return bytes[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_px) + static_cast<std::size_t>(x)];
  }
  /// A disc of that radius lies within.
  bool holds(const Eigen::Vector2d& p_px, double radius_px) const;
  /// Mean of 3 x 3 pixels about a point. @pre holds(p_px, 2)
  double mean_about(const Eigen::Vector2d& p_px) const;
};

/// Standard deviation of a pixel's noise, by its grey level: from the picture's flat places, by the median of the mask
/// (1 -2 1; -2 4 -2; 1 -2 1), which sees neither slopes nor straight edges along rows and columns (Immerkaer, Fast
/// noise variance estimation, 1996, with a median instead of a mean). At least that of rounding, 0.29.
class PictureNoise {
 public:
  explicit PictureNoise(const GreyView& picture);
  double sigma(double level) const;

 private:
  static constexpr int kBins = 16;
  std::array<double, kBins> sigma_{};
};

/// What makes a picture unfit for finding anything in it, in one sentence with the remedy; empty if it is dark neither
/// nor out of focus.
std::string picture_problem(const GreyView& picture);

}  // namespace celadon
