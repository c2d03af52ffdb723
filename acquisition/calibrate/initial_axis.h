#pragma once
// The rotary axis to start from: from the boards' motions between pairs of views. README.md, "Initial values".

#include <optional>

#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// What the placements' views with head and lift at 0 show of the axis; pointing upward in the picture.
/// @param estimate a pose for each view
/// @return nothing if no two used views of one placement differ by a degree
/// Views of one placement that follow each other in the encoder's order must lie less than half a turn apart.
std::optional<AxisEstimate> initial_axis(const Estimate& estimate, const Observations& observations);

/// Makes one pose of those of each placement's views with head and lift at 0: the one that most of them agree with.
/// Sets pose and reference_rad of all its views.
/// @pre estimate.axis, and a pose for each view
void gather_placements(Estimate& estimate, Observations& observations);

}  // namespace celadon::calibrate
