#pragma once
// Cylinder, revolution, translational or general: the simplest model that the samples do not contradict.
// Source: README.md, "Model selection".

#include <Eigen/Core>
#include <string>

#include "fitting/fit_ladder.h"
#include "fitting/knot_selection.h"
#include "fitting/normal_solver.h"
#include "fitting/range_fit.h"

namespace celadon {

/// The general fit the others are judged against, and what its residuals say of the noise.
struct ReferenceFit {
  const NormalEquations& equations;
  const Eigen::MatrixXd& free;
  LadderLevels levels;
  double noise_variance = 0;  ///< sigma^2 of one sample of weight 1
  Inflation inflation;        ///< of the errors' correlation
};

struct ModelDecision {
  SurfaceModel model = SurfaceModel::general;        ///< with the form tolerance
  SurfaceModel statistical = SurfaceModel::general;  ///< without
  std::string decided_by;
};

Variation variation_of(SurfaceModel model);

/// The first of cylinder, revolution, translational that passes both tests; general if none does.
ModelDecision select_model(const FitLadder& ladder, const ReferenceFit& reference, double form_tolerance_mm);

/// The value that a standard normal variable stays below with probability 1 - upper_tail. @pre 0 < upper_tail < 0.5
double normal_quantile(double upper_tail);

}  // namespace celadon
