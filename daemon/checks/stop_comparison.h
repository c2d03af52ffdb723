#pragma once
// Do the turns at different stops of head and lift agree? An axis that left its calibration, or an object that moved
// while they moved, shows where two of them saw the same place. Source: README.md, "Self-checks".

#include <filesystem>
#include <optional>

#include "acquisition/axis_stop.h"
#include "acquisition/calibration.h"
#include "daemon/report.h"

namespace celadon {

/// What two stops see of the same places.
struct StopComparison {
  AxisStop first, second;               ///< that differ most for what is expected
  std::optional<AgreementError> error;  ///< second minus first; nullopt: no two saw enough in common
  double stated_mm = 0;                 ///< standard uncertainty of a radius' difference by calibration and axes
};

/// Compares the stops in the log of a whole scan; nullopt where it has one, or cannot be read.
std::optional<StopComparison> compare_stops(const std::filesystem::path& log_file, const Calibration& calibration);

}  // namespace celadon
