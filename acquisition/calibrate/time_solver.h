#pragma once
// When a frame is exposed, from a board that passes the camera on the turning table. README.md, (14) to (16).

#include <optional>
#include <vector>

#include "acquisition/calibrate/calibration_views.h"
#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// What sweeps show of a machine's time, and of its table's play.
struct TimeEstimate {
  TimeModel time;
  double together_ns = 0;  ///< standard uncertainty of the middle row's instant at the exposures seen
  /// True angle less what the encoder reads, of the table turning backwards against turning forwards. Without backward
  /// sweeps: 0, 0.
  Measured backlash_rad;
  int sweeps = 0;
};

/// The exposure factor is solved for where exposures differ by half and more, and is the assumed one otherwise.
/// @param estimate, observations  of the views at rest, solved; placements that they do not have are passed over
/// @return nullopt if no sweeps at different speeds, one more than there are unknowns, show the board
std::optional<TimeEstimate> estimate_time(const std::vector<BoardSweep>& sweeps, const TimeModel& assumed,
                                          const Estimate& estimate, const Observations& observations);

}  // namespace celadon::calibrate
