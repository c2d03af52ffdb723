#pragma once
// Which rule closes the poles of a sphere: the one that predicts the samples better. Source: README.md, "Poles".

#include <memory>
#include <optional>
#include <string>

#include "fitting/fit_ladder.h"
#include "fitting/knot_selection.h"

namespace celadon {

struct PoleChoice {
  std::unique_ptr<const FitLadder> level_ladder;  ///< the spaces of `level`
  std::optional<LadderSearch::Choice> level;      ///< nullopt: the jet's stays
  std::string told;                               ///< what was compared, in one sentence
};

/// The choice of knots and smoothing that was made with 2-jets, `jet`, against level poles (3.14) with the same knots,
/// by Mallows' Cp. @pre `options` are those of the choice, `ladder` has closed poles
PoleChoice choose_poles(const FitLadder& ladder, int degree_u, int degree_v, JointContinuity continuity,
                        double profiles, LadderSearch::Options options, const LadderSearch::Choice& jet);

}  // namespace celadon
