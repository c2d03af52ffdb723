#pragma once
// Laser planes and the platter's height to start from. README.md, "Initial values".

#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// A plane for each laser whose line was seen on used boards in at least two planes of space; sets
/// LineObservation::plane of boards and platter. Planes stand in the order of the lasers' numbers.
/// @pre a pose for each view
void initial_planes(Estimate& estimate, Observations& observations);

/// The platter's height on the axis from the lines on it; if the boards that stand on it come out below, the axis is
/// turned over with the sense of turning. Nothing if no laser with a plane was seen on it, or there is no axis.
void initial_platter(Estimate& estimate, const Observations& observations);

}  // namespace celadon::calibrate
