#pragma once
// Before a scan: quick turns with the laser that find which exposure suits each part of the turn. README.md, "Exposure
// by the line's peaks".

#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/exposure_plan.h"
#include "daemon/frame_feed.h"
#include "daemon/scan_capture.h"
#include "daemon/scan_job.h"

namespace celadon {

/// With the laser of one turn, at constant speed: a turn with the longest exposure that frame period and room light
/// allow, and as long as places are too bright another with an eighth of it. Leaves all lasers off and the table at
/// rest, where the scan fits its travel.
/// @returns a stop with one sentence where the camera does not take exposures
tl::expected<ExposureChoice, ScanStop> find_exposures(const ScanEquipment& equipment, FrameFeed& feed,
                                                      const LaserTurn& turn);

}  // namespace celadon
