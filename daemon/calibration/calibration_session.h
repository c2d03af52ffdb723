#pragma once
// Takes the views of a calibration on a machine, together with whoever holds the board.

#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/calibrate/calibration_views.h"
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
};

/// One look for a board that is held.
struct BoardLook {
  bool found = false;
  std::string problem;  ///< why it was not found, and what to do
  bool still = false;   ///< as it was in the look before
  bool known = false;   ///< a view like it was taken already
  int views = 0, wanted = 0;
  std::string advice;  ///< what is missing; empty once nothing is
};

/// The operator, as the calibration sees him.
class CalibrationGuide {
 public:
  virtual ~CalibrationGuide() = default;
  /// Something has to be done by hand, now.
  virtual void ask(const std::string& instruction) = 0;
  /// It is done; asked again and again, a tenth of a second of the machine's clock apart. A press of the machine's own
  /// button says so, too.
  virtual bool done() = 0;
  virtual void on_look(const BoardLook& look) = 0;
  /// The table turns with the board on it.
  virtual void on_turn(int placement, int angle, int angles, bool found) = 0;
  /// The table turned to and fro before the camera; in so many frames the board was found.
  virtual void on_passes(int placement, int frames) = 0;
  /// Head or lift moved, with the board on the platter.
  virtual void on_stop(int placement, const AxisStop& stop, bool found) = 0;
  /// Why the calibration shall end now; nullopt: it goes on.
  virtual std::optional<std::string> cancelled() = 0;
};

/// Held views first, each with the line of every laser on it; then the board on the platter, turned, in passes before
/// the camera, and seen from the stops of head and lift where the machine has them; then the lines on the bare platter.
/// On every way out the lasers are off, the motors stand, and head and lift are at 0; but after a fault, an open
/// interlock or a press of the machine's button nothing moves any more.
tl::expected<CalibrationInput, ScanStop> take_calibration_views(ScannerConnection& machine, const CalibrationPlan& plan,
                                                                CalibrationGuide& guide);

}  // namespace celadon
