#pragma once
// The laser line's light on the image, from the traced fan.

#include <cstddef>
#include <vector>

#include "sim/laser_fan.h"

namespace celadon::sim {

class LinePicture {
 public:
  explicit LinePicture(const OpticsConfig& config);

  /// Columns [from, to) of a row that the laser lights.
  struct Span {
    int from = 0, to = 0;
  };
  void clear();
  /// Adds a strand's light; weight: its share of the exposure.
  void draw(const Strand& strand, const LaserSheet& sheet, double weight, const Exposure& exposure);

  /// Levels, height x width.
  const std::vector<float>& levels() const { return levels_; }
  Span lit(int row) const { return lit_[static_cast<std::size_t>(row)]; }

 private:
  using Places = std::array<double, kAcross>;
  struct Crossing;  ///< where the places across the sheet meet a row
  bool cross(const Strand& strand, int ray, int row, Crossing& crossing) const;
  void draw_row(int row, const LaserSheet& sheet, const Places& x, const Places& brightness, int first, int last,
                double scale);
  void draw_reflection(int row, double x_px, double sigma_px, double peak);
  float* light(int row, int from, int to);

  OpticsConfig config_;
  std::vector<float> levels_;
  std::vector<Span> lit_;
};

}  // namespace celadon::sim
