#pragma once
// Which samples count where the same place is seen in two turns with two exposures.

#include <cstdint>
#include <span>

#include "acquisition/laser_line.h"
#include "fitting/profile.h"

namespace celadon {

/// Leaves out of a profile what the turn with the other exposure sees better: of the longer one saturated rows, of the
/// shorter one faint rows, unless the longer one saturates them. Left out, not weighted: the sums of a fit weigh
/// samples alike. Nothing where both exposures are the same.
/// @param other_ns  that the other turn has at this angle of the table
void leave_to_other_exposure(std::span<const LineRow> rows, std::int64_t exposure_ns, std::int64_t other_ns,
                             Profile& profile);

/// All samples of a profile that another turn sees better.
void leave_out(Profile& profile);

}  // namespace celadon
