#pragma once
// Second pass: residuals to a first function, their correlation, and where asked for new sums with weights.
// Source: README.md, "Weights" and "Passes".

#include <optional>

#include "fitting/coverage.h"
#include "fitting/executor.h"
#include "fitting/moment_grid.h"
#include "fitting/noise_correlation.h"
#include "fitting/profile.h"
#include "fitting/range_function.h"
#include "fitting/robust_reference.h"

namespace celadon {

/// What is asked of the pass.
struct WeighingTask {
  const RangeFunction& function;         ///< residuals are to it
  const RobustReference* judge;          ///< whose verdicts weigh the samples; nullptr: all count alike
  std::optional<WeightRule> new_sums{};  ///< sums with these weights are wanted
  double scale_mm = 0;                   ///< standard deviation of a sample of weight 1, for WeightRule::covariance
  std::optional<GridSpecification> revolution{};  ///< and sums for a revolution alone over this grid
  NoiseCorrelation::Setting correlation;
  Executor executor = run_in_turn;
};

struct Weighing {
  explicit Weighing(const NoiseCorrelation::Setting& setting) : correlation(setting) {}
  double residual_square = 0, samples = 0;  ///< of the samples with weight
  double weighted_square = 0, weight = 0;   ///< sums of w e^2 and w
  NoiseCorrelation correlation;
  std::optional<MomentGrid> sums;  ///< weights with the mean 1
  std::optional<SectorExtents> extents;
  std::optional<MomentGrid> revolution;

  void merge(const Weighing& later);
};

/// `sums`: those of the first pass, whose grid the new ones share.
Weighing weigh(const MomentGrid& sums, ProfileParts parts, const WeighingTask& task);

}  // namespace celadon
