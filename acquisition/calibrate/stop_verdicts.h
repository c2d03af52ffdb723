#pragma once
// Judges elevation axis and lift against limits. README.md, "Limits".

#include <vector>

#include "acquisition/calibrate/calibration_solver.h"
#include "acquisition/calibrate/uncertainty.h"

namespace celadon::calibrate {

/// Steps "elevation" and "lift", each where a view was taken off 0 of that axis.
/// @param solution its figures are read, its steps are not
std::vector<CalibrationStep> judge_stops(const Observations& observations, const Estimate& estimate,
                                         const Uncertainty& uncertainty, const CalibrationSolution& solution);

}  // namespace celadon::calibrate
