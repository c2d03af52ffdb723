#pragma once
// A calibration with one of its numbers moved: how uncertainties of a calibration reach what is measured with it. The
// names and what they move: CALIBRATION.md, "covariance".

#include <string>

#include "acquisition/calibration.h"

namespace celadon {

/// Whether the calibration has a number of this name.
bool has_parameter(const Calibration& calibration, const std::string& name);

/// The calibration with one number moved by `step`, in its own unit. The covariance is left.
/// @throws std::invalid_argument unless has_parameter()
Calibration changed(const Calibration& calibration, const std::string& name, double step);

}  // namespace celadon
