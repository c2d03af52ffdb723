#include "fitting/pole_choice.h"

#include <utility>

#include "fitting/fit_report.h"

namespace celadon {

PoleChoice choose_poles(const FitLadder& ladder, int degree_u, int degree_v, JointContinuity continuity,
                        double profiles, LadderSearch::Options options, const LadderSearch::Choice& jet) {
  PoleChoice result;
  CellBand band = ladder.band();
  band.poles.rule = PoleRule::level;
  result.level_ladder = std::make_unique<const FitLadder>(ladder.sums(), band, degree_u, degree_v, continuity);
  options.fixed = jet.fit.levels;
  auto level = LadderSearch(ladder.sums(), *result.level_ladder, profiles).select(options);
  const auto cp = [&](const LadderFit& fit) {
    const double around = fit.equations->matrix().count_v();
    return fit.residual_square +
           2 * options.noise_variance * options.inflation.mean(fit.parameters, around) * fit.parameters;
  };
  const double of_jet = cp(jet.fit), of_level = level ? cp(level->fit) : 0;
  if (!level) {
    result.told = "2-jet: the samples do not determine a level pole";
  } else if (of_level < of_jet) {
    result.told = text("level: Cp %.6g mm2 against %.6g mm2 of the 2-jet", of_level, of_jet);
    level->stopped_by = jet.stopped_by;
    result.level = std::move(level);
    return result;
  } else {
    result.told = text("2-jet: Cp %.6g mm2 against %.6g mm2 of the level pole", of_jet, of_level);
  }
  result.level_ladder.reset();
  return result;
}

}  // namespace celadon
