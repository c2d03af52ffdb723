#pragma once
// What a printed AprilTag looks like, from near enough to see its cells.

#include <vector>

namespace celadon {

/// A tag of the family tag36h11 with its white border. Coordinates as libapriltag's: x to the right, y down, the black
/// square from -1 to 1.
class TagPicture {
 public:
  static constexpr int kNumbers = 587;     ///< of the family
  static constexpr double kBorder = 1.25;  ///< the white border ends at +-
  static constexpr double kCell = 0.25;    ///< side of a cell
  /// @pre 0 <= number < kNumbers
  explicit TagPicture(int number);
  /// Share of white at a point, 0 to 1, blurred by a quarter of a cell; beyond the border as at its edge.
  double white(double x, double y) const;

 private:
  static constexpr int kPerCell = 8, kSide = 10 * kPerCell;
  std::vector<float> levels_;  ///< kSide x kSide, row by row
};

}  // namespace celadon
