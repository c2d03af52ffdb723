#pragma once
// When no surface can be fitted, and what the report tells of one that was: sentences for an operator.

#include <optional>
#include <string>

#include "fitting/coverage.h"
#include "fitting/fit_ladder.h"
#include "fitting/range_fit.h"

namespace celadon {

/// printf into a string.
[[gnu::format(printf, 1, 2)]] std::string text(const char* format, ...);

/// Options or sums that cannot give a surface.
std::optional<FitError> refuse(const MomentGrid& sums, const RangeFitOptions& options);
/// A band that nothing covers, or if `whole_turn` less than half of the turn.
std::optional<FitError> refuse(const CoveredBand& band, bool whole_turn);
/// Fewer samples than the smallest surface asked for has unknowns.
std::optional<FitError> refuse_too_few(const MomentGrid& sums, const FitLadder& ladder, const RangeFitOptions& options);

/// A range function that is not positive everywhere: its surface would cross the axis.
std::optional<FitError> refuse_crossing(const RangeFunction& function);

/// The parts of the report that surface, band and sums determine.
void describe(RangeFit& fit, const CoveredBand& band, const MomentGrid& sums);
/// Sentences on what the report's numbers mean for the operator.
void warn(RangeFit& fit, const CoveredBand& band);

}  // namespace celadon
