#pragma once
// Where a board's corners lie in a picture, roughly: from whole chessboards, or from the tags that are seen.

#include <memory>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibrate/board_picture.h"
#include "acquisition/calibrate/corner_saddle.h"
#include "acquisition/calibrate/target_board.h"

namespace celadon {

struct CornerGuess {
  int id = 0;  ///< BoardCorner::id
  SaddleGuess saddle;
  double tolerance_px = 1;  ///< the fitted corner lies within
};

/// The disc about a corner that its squares' other corners and, on a tag board, the tags stay out of.
/// @param along_row, along_column sides of a square, px
double free_radius_px(const Eigen::Vector2d& along_row, const Eigen::Vector2d& along_column, bool has_tags);

/// Error: what was seen instead, in one sentence.
tl::expected<std::vector<CornerGuess>, std::string> guess_chessboard(const GreyView& picture, const TargetBoard& board);

/// The detector of libapriltag for one board.
class TagBoardDetector {
 public:
  explicit TagBoardDetector(const TargetBoard& board);
  ~TagBoardDetector();
  TagBoardDetector(const TagBoardDetector&) = delete;
  TagBoardDetector& operator=(const TagBoardDetector&) = delete;
  /// Error: what was seen instead, in one sentence.
  tl::expected<std::vector<CornerGuess>, std::string> guess(const GreyView& picture);

 private:
  struct Tag {
    int id = 0, column = 0, row = 0;
    Eigen::Matrix3d H;  ///< from the tag's black square, -1 to 1, y down, to pixels
  };
  std::vector<Tag> detect(const GreyView& picture, std::vector<int>& others);
  /// Leaves those that lie as on the board.
  void keep_consistent(std::vector<Tag>& tags) const;

  TargetBoard board_;
  struct Library;
  std::unique_ptr<Library> library_;
};

}  // namespace celadon
