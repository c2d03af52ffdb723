#pragma once
// Where the fiducials on the platter are, once the machine is calibrated: what every later scan compares with.

#include <span>
#include <vector>

#include "acquisition/calibration.h"
#include "acquisition/datum/rim_tag_finder.h"

namespace celadon {

/// The platter at one angle of the table.
struct RimView {
  double encoder_rad = 0;
  std::vector<SeenTag> tags;
};

/// Corners of the tags that were seen at three angles or more, each the point nearest to its rays, turned back to table
/// angle 0; rays that miss it by more than the others are left out. u_mm is the scatter of the rays over the root of
/// their number, not less than 2 micrometres. A tag whose corners come out of the shape of a square by more than 5 % of
/// its side, or that was seen at two places, is not on the platter, and is left out.
std::vector<RimTag> survey_rim(const Calibration& calibration, std::span<const RimView> views);

}  // namespace celadon
