#pragma once
// The bundle solved while what disagrees with it is left out. README.md, "What is left out".

#include <string>

#include <tl/expected.hpp>

#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// First with soft weights, then plain least squares of what is not off, until nothing changes any more.
/// Errors: as solve_bundle
tl::expected<Estimate, std::string> adjusted(Observations& observations, Estimate estimate);

}  // namespace celadon::calibrate
