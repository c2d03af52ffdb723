#pragma once
// The laser line's light on the image, from the traced fan.

#include <cstddef>
#include <vector>

#include "sim/laser_fan.h"
#include "sim/line_effects.h"

namespace celadon::sim {

class LinePicture {
 public:
  explicit LinePicture(const OpticsConfig& config);

  /// Columns [from, to) of a row that the laser lights.
  struct Span {
    int from = 0, to = 0;
  };
  void clear();
  /// Adds the light of a strand of laser 0 or 1; weight: its share of the exposure.
  void draw(const Strand& strand, int laser, double weight, const Exposure& exposure);

  /// Levels, height x width.
  const std::vector<float>& levels() const { return levels_; }
  Span lit(int row) const { return lit_[static_cast<std::size_t>(row)]; }

 private:
  using Places = std::array<double, kAcross>;
  struct Crossing {  ///< where the places across the sheet meet a row
    Places x{}, brightness{};
    int first = 0, last = 0;  ///< places about the middle along which x rises or falls strictly
    double halo_px = 0, px_per_mm = 0;
    FieldsOnRow fields;
  };
  bool cross(const Strand& strand, int ray, int row, Crossing& crossing) const;
  void note_surface(const Strand& strand, int ray, const std::array<int, kAcross>& pairs, int row,
                    Crossing& crossing) const;
  void draw_row(int row, const LaserSheet& sheet, const Crossing& crossing, double all);
  void draw_reflection(int row, double x_px, double sigma_px, double peak);
  float* light(int row, int from, int to);

  OpticsConfig config_;
  std::vector<float> levels_;
  std::vector<Span> lit_;
  std::vector<float> row_;  ///< light of one crossing, before the fields
};

}  // namespace celadon::sim
