#pragma once
// Flat calibration targets: what is printed on them, and where their corners are.

#include <Eigen/Core>
#include <string>
#include <vector>

#include <tl/expected.hpp>

namespace celadon {

/// An inner corner of the printed squares, in the board's frame: origin in the middle of the print, x to the right, y
/// down, z into the board.
struct BoardCorner {
  int id = 0;  ///< row by row, from the upper left
  Eigen::Vector2d p_mm;
};

/// A chessboard of columns x rows squares whose upper left square is black. On a tag board each white square holds an
/// AprilTag (tag36h11; numbers row by row from first_tag on) in its middle, so that a part of the board tells which
/// part it is; the corners are the chessboard's on both.
class TargetBoard {
 public:
  static constexpr int kTagFamilySize = 587;
  static constexpr double kTagShare = 0.75;  ///< side of a tag's black square / side of its white square

  /// "chessboard:11x8x8" or "tags:11x8x12": columns x rows x side of a square in mm; "tags:11x8x12+40": first tag 40.
  /// Errors: one sentence.
  static tl::expected<TargetBoard, std::string> parse(const std::string& text);
  /// @pre columns, rows >= 3, square_mm > 0; with tags: enough of them from first_tag on
  TargetBoard(int columns, int rows, double square_mm, bool tags, int first_tag = 0);

  std::string text() const;  ///< what parse() reads
  int columns() const { return columns_; }
  int rows() const { return rows_; }
  double square_mm() const { return square_mm_; }
  bool has_tags() const { return tags_; }
  /// Number of the tag in the square, -1 for black squares and on a chessboard.
  int tag_at(int column, int row) const;
  const std::vector<BoardCorner>& corners() const { return corners_; }

 private:
  int columns_, rows_;
  double square_mm_;
  bool tags_;
  int first_tag_;
  std::vector<BoardCorner> corners_;  ///< (columns - 1) x (rows - 1)
};

}  // namespace celadon
