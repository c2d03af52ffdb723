#pragma once
// Which corners, lines and views disagree with the others.

#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// How the weights follow from the residuals.
enum class Weighting {
  soft,  ///< Geman and McClure's: what is far off counts little, nothing is decided
  hard,  ///< 1 or 0; lines and views of which too much is off are left out whole
};

/// Sets weights and `used` from the residuals. The unit is the stated standard deviation, or what the middle residuals
/// show if that is more. A held view that was left out before stays out: nothing gives it a pose.
/// @return whether anything changed (soft: true)
bool set_weights(Observations& observations, Weighting weighting);

}  // namespace celadon::calibrate
