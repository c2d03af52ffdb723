#pragma once
// Standard deviations of pieces that were joined: near a rim a piece is what the samples of both made of it.
// Source: README.md, "Standard deviations".

#include <span>

#include "fitting/coefficient_covariance.h"
#include "fitting/deviation_map.h"
#include "fitting/piece_join.h"
#include "fitting/range_function.h"

namespace celadon {

/// The end of a piece at which another one was joined to it.
struct JoinedEnd {
  bool at_end;                         ///< of u, else at its start
  const CoefficientCovariance* other;  ///< of the other piece as it was fitted alone
  double other_along;                  ///< where the rim lies on its base: the height of a body's, 1 of a head's
  BodyShare of_body;                   ///< as join() gave it
};

/// From the covariance of a piece as it was fitted alone and what join() made of it. What join() does to values and
/// slopes at the rim is taken to first order, at one v: its splines around resolve it. Errors of the two pieces count
/// as independent.
DeviationMap joined_deviation(const CoefficientCovariance& alone, const RangeFunction& joined,
                              std::span<const JoinedEnd> ends);

}  // namespace celadon
