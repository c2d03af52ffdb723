#pragma once
// How well the parameters predict views that had no part in them. README.md, "Held-out views".

#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// Root mean square distance in pixels between predicted and seen corners: each fifth of the views by the parameters of
/// the others, its poses from every other corner, the error at the corners between. Corners left out do not count.
/// Infinite if a fifth cannot be predicted.
double held_out_rms_px(const Observations& observations, const Estimate& solution);

}  // namespace celadon::calibrate
