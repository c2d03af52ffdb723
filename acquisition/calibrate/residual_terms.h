#pragma once
// The residuals of the bundle as Ceres' cost functions, one for a view's corners and one for each line. README.md,
// "The bundle".

#include <ceres/cost_function.h>

#include <memory>
#include <vector>

#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// A cost function with the parameter blocks that it is asked with.
struct Term {
  std::unique_ptr<ceres::CostFunction> cost;
  std::vector<double*> blocks;
};

/// All residuals of positive weight about an estimate, in standard deviations, in the charts of `parameters`. The
/// priors of the pitch and of the platter's slope are among them.
/// @pre parameters were made of `estimate`, and outlive the terms, as do the observations
std::vector<Term> terms_of(const Observations& observations, const Estimate& estimate, Parameters& parameters);

/// Standard deviation that a platter's slope against the axis is expected to have.
constexpr double kPlatterSlopePrior = 0.01;

}  // namespace celadon::calibrate
