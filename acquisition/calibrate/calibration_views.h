#pragma once
// What a calibration is computed from.

#include <vector>

#include "acquisition/angle_timeline.h"
#include "acquisition/axis_stop.h"
#include "acquisition/calibrate/board_finder.h"
#include "acquisition/calibrate/target_board.h"
#include "acquisition/calibration.h"
#include "acquisition/datum/rim_survey.h"

namespace celadon {

/// A point of a laser's line: pixel, and standard deviation across the line.
struct SeenLinePoint {
  Eigen::Vector2d p_px = Eigen::Vector2d::Zero();
  double sigma_px = 0;
};

/// A laser's line on the board, or on the bare platter; points beside them are left out by whoever fills this.
struct SeenLine {
  int laser = 0;
  std::vector<SeenLinePoint> points;
};

/// One pose of the board.
struct BoardView {
  static constexpr int kHeld = -1;
  std::vector<SeenCorner> corners;
  std::vector<SeenLine> lines;  ///< with the board in the same pose
  /// kHeld: the board is somewhere. From 0 on: it stands on the platter; views of one placement differ by the table's
  /// angle and the stop alone.
  int placement = kHeld;
  double encoder_rad = 0;  ///< unwrapped
  AxisStop stop;           ///< of a board on the platter: what the axes beside the table read
};

/// A frame of the board while the table turned.
struct MovingView {
  AngleAtInstant at_stamp;  ///< of the encoder, at the frame's stamp
  std::int64_t exposure_ns = 0;
  std::vector<SeenCorner> corners;
};

/// The board of a placement passing the camera at constant speed.
struct BoardSweep {
  int placement = 0;
  std::vector<MovingView> views;
};

struct CalibrationInput {
  TargetBoard board;
  int width_px = 0, height_px = 0;
  std::vector<BoardView> views;
  std::vector<SeenLine> platter;  ///< on the bare platter: says where z = 0 is
  std::vector<RimView> rim;       ///< the bare platter all round; empty: it has no fiducials
  /// Measured length / nominal length of the print, along its x and y. Unmeasured: 1, 0.003.
  Measured pitch_x{1, 0.003}, pitch_y{1, 0.003};
  std::vector<BoardSweep> sweeps = {};  ///< empty: nobody looked, and frames are exposed as `assumed_time` says
  TimeModel assumed_time = {};
};

}  // namespace celadon
