#pragma once
// Calibration targets: what is printed on a plane, and where its corners are.

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

namespace celadon::sim {

inline constexpr double kPaper = 0.9, kInk = 0.05;  ///< reflectances

/// A corner that a detector finds, millimetres from the target's middle, x to the right, y down.
struct TargetCorner {
  int id = 0;      ///< of the tag; 0 for a chessboard
  int corner = 0;  ///< chessboard: row by row; tag: lower left, lower right, upper right, upper left
  Eigen::Vector2d p_mm;
};

/// Black and white cells of equal size on a rectangle of paper.
class Target {
 public:
  /// Squares of 8 mm, 11 x 8 with a margin as wide: 10 x 7 inner corners.
  static Target chessboard();
  /// 5 x 4 tags of the family tag36h11, numbers 0 to 19, 12 mm wide, 4.5 mm apart.
  static Target tag_grid();
  /// One tag of that family. @pre 0 <= id < 587, size: of the black square
  static Target tag(int id, double size_mm);

  double width_mm() const { return columns_ * cell_mm_; }
  double height_mm() const { return rows_ * cell_mm_; }
  /// kPaper or kInk at a point from the middle; 0 off the paper.
  double reflectance(double x_mm, double y_mm) const;
  const std::vector<TargetCorner>& corners() const { return corners_; }

 private:
  Target(int columns, int rows, double cell_mm);
  void ink(int column, int row) { cells_[static_cast<std::size_t>(row * columns_ + column)] = 1; }
  void add_tag(int id, int column, int row);
  Eigen::Vector2d at(int column, int row) const;  ///< upper left corner of a cell

  int columns_, rows_;
  double cell_mm_;
  std::vector<std::uint8_t> cells_;
  std::vector<TargetCorner> corners_;
};

}  // namespace celadon::sim
