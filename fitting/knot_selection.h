#pragma once
// How many knots, and how much smoothing: the member of the dyadic ladder with the least Mallows' Cp, or the first one
// that holds a tolerance. Source: README.md, "Knots".

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "fitting/fit_ladder.h"
#include "fitting/model_selection.h"
#include "fitting/normal_solver.h"

namespace celadon {

/// A solved member of the ladder.
struct LadderFit {
  std::unique_ptr<NormalEquations> equations;
  Eigen::MatrixXd free;
  int level_u = 0, level_v = 0;
  double residual_square = 0, parameters = 0, cp = 0;
  double smoothing = 0;  ///< relative weight of the bending energy
  std::string stopped_by;
};

struct KnotOptions {
  Variation variation;
  double tolerance_mm = 0;
  bool smoothing = true;
  std::optional<int> level_u, level_v;  ///< fixed
  /// 95th percentile of |e| of a fit; by default 1.96 times its RMS.
  std::function<double(const RangeFunction&)> percentile95;
};

/// The weight that bridges gaps and touches nothing else, relative to the traces.
inline constexpr double kVanishingWeight = 1e-8;

/// One member, with a vanishing energy where samples are missing. Null: not determined.
std::optional<LadderFit> solve_member(const MomentGrid& sums, const FitLadder& ladder, int level_u, int level_v,
                                      Variation variation);

/// `reference` gives the noise, and its exact residuals those of every member nested in it.
std::optional<LadderFit> select_knots(const MomentGrid& sums, const FitLadder& ladder, const ReferenceFit& reference,
                                      const KnotOptions& options);

}  // namespace celadon
