#pragma once
// Calibration targets: what is printed on a plane, and where its corners are.

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <tl/expected.hpp>

namespace celadon::sim {

inline constexpr double kPaper = 0.9, kInk = 0.05;  ///< reflectances

/// A corner that a detector finds, millimetres from the target's middle, x to the right, y down.
struct TargetCorner {
  int id = 0;  ///< of a single tag; 0 on a board
  int corner =
      0;  ///< board: inner corners of the squares, row by row; tag: lower left, lower right, upper right, upper left
  Eigen::Vector2d p_mm;
};

/// Black and white cells of equal size on a rectangle of paper, as they were meant to be printed.
class Target {
 public:
  /// chessboard:COLUMNSxROWSxSQUARE, squares of that many mm of which the upper left is black, or
  /// tags:COLUMNSxROWSxSQUARE+FIRST: the same with a tag of the family tag36h11 in each white square, three quarters as
  /// wide, numbered row by row. COLUMNS, ROWS and what follows may be left out: 11x8x8 and 10x7x12 fill two thirds of
  /// the default camera's picture. The margin is half a square. Errors: one sentence.
  static tl::expected<Target, std::string> board(std::string_view text);
  /// One tag of that family. @pre 0 <= id < 587, size: of the black square
  static Target tag(int id, double size_mm);

  double width_mm() const { return columns_ * cell_mm_; }
  double height_mm() const { return rows_ * cell_mm_; }
  /// kPaper or kInk at a point from the middle; 0 off the paper.
  double reflectance(double x_mm, double y_mm) const;
  const std::vector<TargetCorner>& corners() const { return corners_; }

 private:
  Target(int columns, int rows, double cell_mm);
  static Target squares(int columns, int rows, double square_mm, bool tags, int first_tag);
  void fill(int column, int row, int width, int height, bool black);
  void add_tag(int id, int column, int row, int unit);
  Eigen::Vector2d at(int column, int row) const;  ///< upper left corner of a cell

  int columns_, rows_;
  double cell_mm_;
  std::vector<std::uint8_t> cells_;
  std::vector<TargetCorner> corners_;
};

}  // namespace celadon::sim
