#pragma once
// The elevation axis and the lift to start from: from the boards' motions between stops. README.md, "Initial values".

#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// Sets estimate.elevation and estimate.lift, each where two views and more off 0 of that axis show a motion of half a
/// degree, half a millimetre and more. Views that are off 0 of an axis that is not found lose all that they saw:
/// nothing says where they stood.
/// @param own_X_CB pose of each view by itself, in the order of the input
/// @pre placements are gathered
void initial_stops(const std::vector<Eigen::Isometry3d>& own_X_CB, Estimate& estimate, Observations& observations);

}  // namespace celadon::calibrate
