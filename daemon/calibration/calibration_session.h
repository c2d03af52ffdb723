#pragma once
// Takes the views of a calibration on a machine, together with whoever holds the board.

#include <tl/expected.hpp>

#include "acquisition/calibrate/calibration_views.h"
#include "daemon/calibration/calibration_guide.h"
#include "daemon/scan_job.h"
#include "daemon/scanner_connection.h"

namespace celadon {

/// What shall be looked at.
struct CalibrationPlan {
  TargetBoard board;
  int held_views = 25;
  int placements = 3;                             ///< of the board on the platter
  int angles = 36;                                ///< of the table, a turn, for each placement
  double exposure_ms = 0;                         ///< 0: the camera's own
  Measured pitch_x{1, 0.003}, pitch_y{1, 0.003};  ///< of the print, measured / nominal
  /// Of each axis beside the table that the machine has, for each placement; 0: they are not calibrated.
  int stops = 8;
  /// Placements at which the board passes the camera; 0: when frames are exposed is not measured.
  int timed_placements = 2;
  bool from_afar = false;  ///< asked for by somebody who may not stand there: needs the machine's switch, and warns
};

/// Held views first, each with the line of every laser on it; then the board on the platter, turned, in passes before
/// the camera, and seen from the stops of head and lift where the machine has them; then the lines on the bare platter.
/// On every way out the lasers are off, the motors stand, and head and lift are at 0; but after a fault, an open
/// interlock or a press of the machine's button nothing moves any more. While a hand is waited for a press says that it
/// is done.
tl::expected<CalibrationInput, ScanStop> take_calibration_views(ScannerConnection& machine, const CalibrationPlan& plan,
                                                                CalibrationGuide& guide);

}  // namespace celadon
