#pragma once
// Judges what is known of when frames are exposed. README.md, "Limits".

#include <optional>

#include "acquisition/calibrate/calibration_solver.h"
#include "acquisition/calibrate/time_solver.h"

namespace celadon::calibrate {

/// The step "time". It is never refused: scans in steps need no time model.
/// @param time nullopt: the sweeps did not show it
CalibrationStep judge_time(const std::optional<TimeEstimate>& time, int height_px);

}  // namespace celadon::calibrate
