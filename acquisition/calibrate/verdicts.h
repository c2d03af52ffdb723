#pragma once
// Judges each step of a calibration against limits. README.md, "Limits".

#include <vector>

#include "acquisition/calibrate/calibration_solver.h"
#include "acquisition/calibrate/uncertainty.h"

namespace celadon::calibrate {

/// @param solution its figures are read, its steps are not
std::vector<CalibrationStep> judge(const CalibrationInput& input, const Observations& observations,
                                   const Estimate& estimate, const Uncertainty& uncertainty,
                                   const CalibrationSolution& solution);

}  // namespace celadon::calibrate
