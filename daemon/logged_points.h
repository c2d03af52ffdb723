#pragma once
// Points of a profile log with how they were lit.

#include <cstddef>

#include "acquisition/remeasured_points.h"
#include "daemon/profile_log.h"

namespace celadon {

/// Every `every`-th sample of the turns, without what is seen again beyond them. What a damaged log holds before the
/// damage; its reader tells. @pre every >= 1
ScannedPoints logged_points(ProfileLogReader& log, std::size_t every);

}  // namespace celadon
