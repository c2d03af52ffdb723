#pragma once
// The residuals of the bundle as Ceres' cost functions, one for a view's corners and one for each line. README.md,
// "The bundle".

#include <ceres/cost_function.h>

#include <memory>
#include <vector>

#include "acquisition/calibrate/observations.h"
#include "acquisition/calibrate/shared_errors.h"

namespace celadon::calibrate {

/// A cost function with the parameter blocks that it is asked with.
struct Term {
  std::unique_ptr<ceres::CostFunction> cost;
  std::vector<double*> blocks;
  std::vector<Origin> origins;  ///< of each residual; none for priors and the platter
};

/// All residuals of positive weight about an estimate, in standard deviations, in the charts of `parameters`. The
/// priors of the print, of the platter's slope and of the encoder's error are among them.
/// @pre parameters were made of `estimate`, and outlive the terms, as do the observations
std::vector<Term> terms_of(const Observations& observations, const Estimate& estimate, Parameters& parameters);

/// Standard deviations that a board's sag at its outermost corner, a platter's slope against the axis, and cosine and
/// sine of the encoder's error are expected to have: of the last a tenth of a millimetre beside the axis at a radius of
/// 30.
constexpr double kSagPrior_mm = 0.5;
constexpr double kPlatterSlopePrior = 0.01;
constexpr double kOnceATurnPrior_rad = 0.003;

}  // namespace celadon::calibrate
