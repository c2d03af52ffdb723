#pragma once
// The plane map from a printed board to its picture.

#include <Eigen/Core>
#include <optional>
#include <span>

#include "acquisition/calibrate/board_finder.h"
#include "acquisition/calibrate/target_board.h"

namespace celadon {

/// Least squares over the corners, from millimetres on the board to pixels; the lens's distortion stays in the
/// residuals. Nothing with under four corners, or if they lie in one line.
std::optional<Eigen::Matrix3d> board_homography(const TargetBoard& board, std::span<const SeenCorner> corners);

}  // namespace celadon
