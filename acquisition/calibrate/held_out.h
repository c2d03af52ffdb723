#pragma once
// How well the parameters predict views that had no part in them. README.md, "Held-out views".

#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// Root mean square distances in pixels between predicted and seen corners, each fifth of the views by the parameters
/// of the others. Corners left out do not count. Infinite if a fifth cannot be predicted; 0 without such views.
struct HeldOutErrors {
  /// Of views with head and lift at 0: each pose from every other corner, the error at the corners between.
  double corner_px = 0;
  double raised_px = 0;  ///< of views with the head off 0, the pose as board, table, head and lift have it
  double lifted_px = 0;  ///< likewise with the lift off 0
};
HeldOutErrors held_out_errors(const Observations& observations, const Estimate& solution);

}  // namespace celadon::calibrate
