#pragma once
// At which stops of head and lift a board on the platter is looked at.

#include <vector>

#include "acquisition/axis_stop.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon {

/// Stops for one placement of the board: the lift's with the head at 0, then the head's with the lift at 0, each from
/// below to above, as many as asked for of each axis that there is. Evenly over the travel, of the head as far as 75
/// degrees and of the lift as far as `reach_mm` to both sides of 0, and moved from placement to placement by an equal
/// part of their distance, so that no two placements have readings in common.
/// @pre 0 <= placement < placements, stops >= 0
std::vector<AxisStop> stops_to_visit(const DeviceCapabilities& machine, int stops, int placement, int placements,
                                     double reach_mm);

}  // namespace celadon
