#pragma once
// Samples of a part of the picture to its pixels, blurred by the lens.

#include <vector>

namespace celadon::sim {

/// A part of a picture, pixels: x0 <= x < x1, y0 <= y < y1.
struct Patch {
  int x0, y0, x1, y1;
  int width() const { return x1 - x0; }
  int height() const { return y1 - y0; }
  bool empty() const { return x0 >= x1 || y0 >= y1; }
};

class LensBlur {
 public:
  /// @param samples  along each side of a pixel, odd
  LensBlur(double blur_px, int samples);

  /// How far about a place its light goes, px.
  int margin_px() const { return margin_; }
  /// Paints the patch over in a picture of so many columns. Beyond its ends a line of samples stays as it is there.
  /// @pre fine.size() == samples^2 * width * height of the patch, row by row
  void apply(const std::vector<float>& fine, const Patch& patch, int columns, std::vector<float>& levels);

 private:
  int samples_, margin_;
  std::vector<float> taps_;
  std::vector<float> lines_;  ///< blurred along the rows, one a pixel
};

}  // namespace celadon::sim
