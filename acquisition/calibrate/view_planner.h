#pragma once
// Which views of a board a calibration still needs, in words for whoever holds it.

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "acquisition/calibrate/board_finder.h"
#include "acquisition/calibrate/target_board.h"

namespace celadon {

/// How a board appears in a picture, as far as that can be told without a calibration.
struct BoardAppearance {
  Eigen::Vector2d middle_px = Eigen::Vector2d::Zero();  ///< of the print
  double px_per_mm = 0;                                 ///< along the direction that is not foreshortened
  /// Angle between board and picture plane, along the direction in the picture in which the board comes nearer.
  Eigen::Vector2d tilt_rad = Eigen::Vector2d::Zero();
  double roll_rad = 0;  ///< of the board's x axis in the picture
};

/// @pre at least 4 corners, no three on a line
BoardAppearance appearance_of(const TargetBoard& board, std::span<const SeenCorner> corners);

class ViewPlanner {
 public:
  /// @param wanted  views, at least
  ViewPlanner(const TargetBoard& board, int width_px, int height_px, int wanted);

  /// The board is not where it was in a view already taken.
  bool is_new(std::span<const SeenCorner> corners) const;
  void add(std::span<const SeenCorner> corners);

  int views() const { return static_cast<int>(views_.size()); }
  int wanted() const { return wanted_; }
  /// As many as wanted, in all parts of the picture, tilted in all four directions and at two distances; or twice as
  /// many.
  bool complete() const;
  /// "Tilt the board so that its left edge comes nearer." Empty once nothing is missing.
  std::string advice() const;

 private:
  TargetBoard board_;
  int width_px_, height_px_, wanted_;
  std::vector<BoardAppearance> views_;
  std::vector<int> corners_in_part_;  ///< of the picture: 3 x 3, row by row
};

}  // namespace celadon
