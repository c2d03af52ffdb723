#pragma once
// Backgrounds of a turn whose exposures differ by angle: a quick turn with the laser off. README.md, "Exposure by the
// line's peaks".

#include <tl/expected.hpp>

#include "acquisition/triangulation.h"
#include "daemon/backgrounds.h"
#include "daemon/exposure_plan.h"
#include "daemon/frame_feed.h"
#include "daemon/scan_job.h"

namespace celadon {

inline constexpr int kQuickProfiles = 144;  ///< of a quick turn: two in each sector of a plan

/// Turns once as the plan exposes. A picture for each 15 degrees, the mean of its frames: the room's light on the
/// object turns with it. Leaves the table at rest, where its travel ends where it stood, and the exposure for there.
/// @pre the laser is off; the plan is not empty
tl::expected<Backgrounds, ScanStop> dark_turn(const ScanEquipment& equipment, FrameFeed& feed,
                                              const Triangulator& triangulator, const ExposurePlan& plan);

}  // namespace celadon
