#pragma once
// Points of a laser's line for a calibration: on the plain parts of a board, and on the bare platter.

#include <span>
#include <vector>

#include "acquisition/calibrate/board_picture.h"
#include "acquisition/calibrate/calibration_views.h"
#include "acquisition/laser_line.h"

namespace celadon {

/// Where the line of `rows` lies on the board, away from the print's edges: what is darker on one side of the line
/// pulls it to the other.
/// @param dark  the picture without the laser, whose corners are `corners`
std::vector<SeenLinePoint> line_points_on_board(const TargetBoard& board, std::span<const SeenCorner> corners,
                                                const GreyView& dark, std::span<const LineRow> rows);

/// The longest straight line among the points of `rows` or, where a line runs along the rows, of `columns` (the same of
/// the picture turned over its diagonal); empty if it has under 40 points.
std::vector<SeenLinePoint> straight_line(std::span<const LineRow> rows, std::span<const LineRow> columns);

}  // namespace celadon
