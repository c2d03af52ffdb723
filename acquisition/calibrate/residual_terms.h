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
/// priors of the print and of the platter's slope are among them.
/// @pre parameters were made of `estimate`, and outlive the terms, as do the observations
std::vector<Term> terms_of(const Observations& observations, const Estimate& estimate, Parameters& parameters);

/// Standard deviations that a board's sag at its outermost corner and a platter's slope against the axis is expected to
/// have.
constexpr double kSagPrior_mm = 0.5;
constexpr double kPlatterSlopePrior = 0.01;

}  // namespace celadon::calibrate
