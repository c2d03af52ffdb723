#pragma once
// How many knots, and how much smoothing: the member of the dyadic ladder with the least Mallows' Cp, or the first one
// that holds a tolerance. Source: README.md, "Knots".

#include <Eigen/Core>
#include <array>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "fitting/fit_ladder.h"
#include "fitting/noise_correlation.h"
#include "fitting/normal_solver.h"

namespace celadon {

/// The weight that bridges gaps and touches nothing else, relative to the traces; and the one that bridges them
/// stiffly, where functions that hardly any samples support shall not decide.
inline constexpr double kVanishingWeight = 1e-5, kStiffWeight = 1e-3;

/// With fewer samples an unknown, Cp itself is too uncertain to choose by; the same of profiles, which share an angle
/// and errors, and unknowns around.
inline constexpr double kSamplesPerUnknown = 3, kProfilesPerUnknown = 1.5;

/// Levels of both directions.
struct LadderLevels {
  int u = 0, v = 0;
  auto operator<=>(const LadderLevels&) const = default;  // NOLINT(modernize-use-nullptr): its 0 is no pointer
};

/// A place along the base where the range (order 0) or its slope (order 1) is held, all around.
struct HeldAlong {
  double along;
  int order;
};

/// A solved member of the ladder.
struct LadderFit {
  std::unique_ptr<NormalEquations> equations;
  Eigen::MatrixXd free;
  LadderLevels levels;
  double residual_square = 0, parameters = 0;
  double smoothing = 0;           ///< relative weight of the bending energy
  std::vector<HeldAlong> held{};  ///< exactly, whatever the samples say
};

/// One member, with an energy of this weight where samples are missing. nullopt: not determined.
std::optional<LadderFit> solve_member(const FitLadder& ladder, LadderLevels levels, Variation variation,
                                      double bridging = kVanishingWeight);

/// The ladder of one set of sums; what a member leaves over is computed once.
class LadderSearch {
 public:
  /// `profiles`: lines of samples that share an angle and errors; infinite for scattered points.
  LadderSearch(const MomentGrid& sums, const FitLadder& ladder, double profiles)
      : sums_(sums), ladder_(ladder), profiles_(profiles) {}

  struct Member {
    double residual_square = 0, parameters = 0;
    bool determined = false;
  };
  const Member& member(LadderLevels levels, Variation variation);

  /// The member, of any model, that predicts best if the noise is independent (least generalised cross validation)
  /// among those with ten samples an unknown: where the noise is estimated.
  struct Candidate {
    LadderLevels levels;
    Variation variation;
  };
  Candidate best_for_white_noise();

  struct Options {
    Variation variation;
    double noise_variance = 0;
    Inflation inflation;
    double tolerance_mm = 0;
    bool smoothing = true;
    double fair_mm = 0;  ///< fair the chosen member as far as 95 % of it moves by no more than this
    std::optional<LadderLevels> fixed;
    /// 95th percentile of |e| of a fit; by default 1.96 times its RMS.
    std::function<double(const RangeFunction&)> percentile95;
  };
  struct Choice {
    LadderFit fit;
    std::string stopped_by;
  };
  /// The member with the least Cp, or the coarsest that holds the tolerance. nullopt: the samples determine none.
  std::optional<Choice> select(const Options& options);

 private:
  using Cost = std::function<double(LadderLevels)>;
  bool exists(LadderLevels levels, Variation variation) const;
  LadderLevels coarsest() const { return {ladder_.levels_u() - 1, ladder_.levels_v() - 1}; }
  struct Share {
    double samples, profiles;  ///< an unknown, and an unknown around
  };
  bool affordable(LadderLevels levels, Variation variation, Share share) const;
  std::optional<LadderLevels> descend(Variation variation, Share share, const Cost& cost,
                                      const std::function<bool(LadderLevels)>& good_enough);
  double floor() const;

  const MomentGrid& sums_;
  const FitLadder& ladder_;
  double profiles_;
  std::map<std::array<int, 4>, Member> members_;
};

}  // namespace celadon
