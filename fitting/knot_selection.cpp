#include "fitting/knot_selection.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <utility>
#include <vector>

namespace celadon {
namespace {

// Sums resolve residuals of this size relative to the range.
constexpr double kResolution = 2e-8;
// With fewer samples an unknown a noise estimate is too low; the same of profiles, which share an angle and errors.
constexpr double kSamplesPerNoiseUnknown = 10, kProfilesPerNoiseUnknown = 3;
// Weights of the energy that fairing may take, and bisections of the last decade.
constexpr double kLeastFairing = 1e-10, kMostFairing = 1e8;
constexpr int kFairingSteps = 7;
constexpr double kUnmistakable = 0.25;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr LadderLevels kSteps[] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};

std::string text(const char* format, double a, double b) {
  std::array<char, 240> buffer;
  std::snprintf(buffer.data(), buffer.size(), format, a, b);
  return buffer.data();
}

// Add bending energy as long as Cp falls: by factors of about three up from `start`. Returns the least Cp.
double smooth(LadderFit& fit, double penalty, double start) {
  const NormalEquations& equations = *fit.equations;
  const Eigen::MatrixXd plain = fit.free, gradient = equations.gradient(plain);
  const double plain_square = fit.residual_square;
  double best = fit.residual_square + penalty * fit.parameters;
  int rises = 0;
  bool found = false;
  SmoothingBasis basis(equations);
  for (double weight = start; weight < 1 && rises < 2; weight *= std::sqrt(10.0)) {
    NormalSolver solver(equations, weight, {.tolerance = 1e-9, .basis = &basis});
    const auto free = solver.solve();
    if (!free) break;
    const Eigen::MatrixXd change = plain - *free;
    const double rss = plain_square + equations.quadratic(change) + 2 * change.cwiseProduct(gradient).sum();
    const double parameters = solver.effective_parameters();
    const double cp = rss + penalty * parameters;
    if (cp < best) {
      best = cp;
      found = true;
      rises = 0;
      fit.free = *free;
      fit.smoothing = weight;
      fit.residual_square = rss;
      fit.parameters = parameters;
    } else if (found || cp > 1.05 * best) {
      ++rises;
    }
  }
  return best;
}

// How far a surface moved: 95 % of it, and all of it; on a grid of four places a coefficient in either direction.
struct Move {
  double most_mm = 0, largest_mm = 0;
};
Move move_between(const RangeFunction& a, const RangeFunction& b) {
  constexpr Eigen::Index kPlaces = 4;
  constexpr double kMovedShare = 0.95;
  const RangeFunction change(a.base(), a.degree_u(), a.degree_v(), a.knots_u(), a.knots_v(),
                             a.coefficients() - b.coefficients());
  const BaseSurface& base = a.base();
  const Eigen::Index rows = kPlaces * a.coefficients().rows(), columns = kPlaces * a.coefficients().cols();
  std::vector<double> theta(static_cast<std::size_t>(columns + 1)), along, value(theta.size()), all;
  all.reserve(theta.size() * static_cast<std::size_t>(rows + 1));
  for (Eigen::Index j = 0; j <= columns; ++j)
    theta[static_cast<std::size_t>(j)] =
        base.arcs.theta_of_v(base.arcs.count() * static_cast<double>(j) / static_cast<double>(columns));
  for (Eigen::Index i = 0; i <= rows; ++i) {
    const double share = static_cast<double>(i) / static_cast<double>(rows);
    along.assign(theta.size(), (1 - share) * base.band_start + share * base.band_end);
    change.evaluate(theta.data(), along.data(), theta.size(), value.data());
    for (const double v : value) all.push_back(std::abs(v));
  }
  const auto most = all.begin() + static_cast<std::ptrdiff_t>(kMovedShare * static_cast<double>(all.size() - 1));
  std::nth_element(all.begin(), most, all.end());
  return {*most, *std::max_element(most, all.end())};
}

// As much bending energy as moves 95 % of the surface by no more than `most_mm`; in one sentence what became of it.
std::string fair(LadderFit& fit, double most_mm) {
  const NormalEquations& equations = *fit.equations;
  const Eigen::MatrixXd plain = fit.free;
  const RangeFunction before = range_function(equations, plain);
  SmoothingBasis basis(equations);
  const auto at = [&](double weight) -> std::optional<Eigen::MatrixXd> {
    NormalSolver solver(equations, weight, {.tolerance = 1e-9, .basis = &basis});
    auto free = solver.solve();
    if (!free || move_between(range_function(equations, *free), before).most_mm > most_mm) return std::nullopt;
    return free;
  };
  double low = std::max(fit.smoothing, kLeastFairing), high = low;
  for (auto free = at(low); free && high < kMostFairing; free = at(high)) {
    fit.free = std::move(*free);
    fit.smoothing = low = high;
    high *= 10;
  }
  for (int k = 0; k < kFairingSteps; ++k) {
    const double middle = std::sqrt(low * high);
    if (auto free = at(middle)) {
      fit.free = std::move(*free);
      fit.smoothing = low = middle;
    } else {
      high = middle;
    }
  }
  fit.residual_square = equations.residual_square(fit.free);
  const Move move = move_between(range_function(equations, fit.free), before);
  const double energy = basis.energy().of(plain);
  return text("; faired: 95 %% of the surface moved by less than %.3g mm, all of it by less than %.3g mm", move.most_mm,
              move.largest_mm) +
         text(", %.2g of the bending energy is left", energy > 0 ? basis.energy().of(fit.free) / energy : 1, 0);
}

}  // namespace

std::optional<LadderFit> solve_member(const FitLadder& ladder, LadderLevels levels, Variation variation,
                                      double bridging) {
  LadderFit fit;
  fit.equations = std::make_unique<NormalEquations>(ladder.equations(levels.u, levels.v, variation));
  fit.levels = levels;
  const NormalEquations& equations = *fit.equations;
  std::optional<Eigen::MatrixXd> free;
  if (equations.empty_cells() == 0) free = NormalSolver(equations).solve();
  if (!free) {
    // The energy shall decide only what the samples leave open: two steps back towards plain least squares.
    NormalSolver bridged(equations, bridging, {.direct = true});
    free = bridged.solve();
    for (int k = 0; free && k < 2; ++k)
      if (const auto step = bridged.apply_inverse(equations.gradient(*free))) *free += *step;
  }
  if (!free || !free->allFinite()) return std::nullopt;
  fit.free = std::move(*free);
  fit.parameters = equations.supported_unknowns();
  fit.residual_square = equations.residual_square(fit.free);
  return fit;
}

const LadderSearch::Member& LadderSearch::member(LadderLevels levels, Variation variation) {
  if (!variation.along_u) levels.u = coarsest().u;
  if (!variation.around_v) levels.v = coarsest().v;
  const auto [entry, fresh] = members_.try_emplace({levels.u, levels.v, variation.along_u, variation.around_v});
  if (fresh) {
    if (const auto fit = solve_member(ladder_, levels, variation))
      entry->second = {fit->residual_square, fit->parameters, true};
  }
  return entry->second;
}

bool LadderSearch::exists(LadderLevels at, Variation variation) const {
  const LadderLevels end = coarsest();
  return at.u >= 0 && at.v >= 0 && at.u <= end.u && at.v <= end.v && (variation.along_u || at.u == end.u) &&
         (variation.around_v || at.v == end.v);
}

// Down from the coarsest member in both directions together until the cost has risen twice in a row, then in each
// direction alone from the best. Stops at the first member that is good enough, and coarsens that as far as it stays
// so.
bool LadderSearch::affordable(LadderLevels at, Variation variation, Share share) const {
  return share.samples * ladder_.unknowns(at.u, at.v, variation) <= static_cast<double>(sums_.samples()) &&
         (!variation.around_v || share.profiles * ladder_.unknowns(at.u, at.v, {false, true}) <= profiles_);
}

std::optional<LadderLevels> LadderSearch::descend(Variation variation, Share share, const Cost& cost,
                                                  const std::function<bool(LadderLevels)>& good_enough) {
  LadderLevels at = coarsest(), best = at;
  double least = kInfinity;
  bool held = false;
  for (int rises = 0; rises < 2;) {
    const double here = cost(at);
    if (here < least) {
      least = here, best = at, rises = 0;
    } else {
      ++rises;
    }
    if (good_enough && good_enough(at)) {
      best = at, held = true;
      break;
    }
    LadderLevels next{at.u - 1, at.v - 1};
    if (!exists({next.u, at.v}, variation)) next.u = at.u;
    if (!exists({at.u, next.v}, variation)) next.v = at.v;
    if (next == at || !affordable(next, variation, share)) break;
    at = next;
  }
  for (bool moved = true; moved;) {
    moved = false;
    for (const LadderLevels& step : kSteps) {
      const LadderLevels next{best.u + step.u, best.v + step.v};
      const bool finer = step.u + step.v < 0;
      if (!exists(next, variation) || (finer && (held || !affordable(next, variation, share)))) continue;
      if (held ? !good_enough(next) : !(cost(next) < least)) continue;
      if (!held) least = cost(next);
      best = next;
      moved = true;
    }
  }
  if (!held && least == kInfinity) return std::nullopt;
  return best;
}

double LadderSearch::floor() const {
  const double weight = sums_.sum_weight();
  const double resolved = weight > 0 ? kResolution * sums_.sum_weighted_range() / weight : 0;
  return weight * resolved * resolved;
}

LadderSearch::Candidate LadderSearch::best_for_white_noise() {
  const double n = static_cast<double>(sums_.samples()), least = floor();
  Candidate best{coarsest(), {}};
  double best_score = kInfinity;
  const auto search = [&](Share share, double better) {
    for (const bool around : {false, true})
      for (const bool along : {false, true}) {
        const Variation variation{along, around};
        const Cost score = [&](LadderLevels at) {
          const Member& m = member(at, variation);
          const double left = n - m.parameters;
          return m.determined && left > 0 ? std::max(m.residual_square, least) / (left * left) : kInfinity;
        };
        const auto levels = descend(variation, share, score, {});
        if (!levels || !(score(*levels) < better * best_score)) continue;
        best = {*levels, variation};
        best_score = score(*levels);
      }
  };
  search({kSamplesPerNoiseUnknown, kProfilesPerNoiseUnknown}, 1);
  // Few profiles of an object with many lobes: what falls so far with a few unknowns more was no error of the profiles.
  search({kSamplesPerNoiseUnknown, kProfilesPerUnknown}, kUnmistakable);
  return best;
}

std::optional<LadderSearch::Choice> LadderSearch::select(const Options& options) {
  const Variation variation = options.variation;
  const double least = floor();
  const auto penalty = [&](LadderLevels at) {
    return 2 * options.noise_variance *
           options.inflation.mean(ladder_.unknowns(at.u, at.v, variation),
                                  ladder_.unknowns(at.u, at.v, {false, variation.around_v}));
  };
  const Cost cp = [&](LadderLevels at) {
    const Member& m = member(at, variation);
    return m.determined ? std::max(m.residual_square, least) + penalty(at) * m.parameters : kInfinity;
  };
  std::map<LadderLevels, double> percentiles;
  const auto percentile = [&](const LadderFit& fit) {
    if (options.percentile95) return options.percentile95(range_function(*fit.equations, fit.free));
    return 1.96 * std::sqrt(fit.residual_square / fit.equations->weight());
  };
  const auto holds = [&](LadderLevels at) {
    const auto [entry, fresh] = percentiles.try_emplace(at, kInfinity);
    if (fresh)
      if (const auto fit = solve_member(ladder_, at, variation)) entry->second = percentile(*fit);
    return entry->second <= options.tolerance_mm;
  };
  std::function<bool(LadderLevels)> good_enough;
  if (options.tolerance_mm > 0) good_enough = holds;
  const auto levels =
      options.fixed ? options.fixed : descend(variation, {kSamplesPerUnknown, kProfilesPerUnknown}, cp, good_enough);
  if (!levels) return std::nullopt;
  auto fit = solve_member(ladder_, *levels, variation);
  if (!fit) return std::nullopt;
  Choice choice{std::move(*fit), {}};

  const bool varies = variation.along_u || variation.around_v;
  const bool finest = (!variation.along_u || levels->u == 0) && (!variation.around_v || levels->v == 0);
  const bool exact = choice.fit.residual_square <= least;
  const bool held = options.tolerance_mm > 0 && percentile(choice.fit) <= options.tolerance_mm;
  if (!varies) {
    choice.stopped_by = "a cylinder has no knots to refine";
  } else if (options.fixed) {
    choice.stopped_by = "intervals as given";
  } else if (held) {
    choice.stopped_by =
        text("tolerance: 95th percentile %.3g mm within %.3g mm", percentile(choice.fit), options.tolerance_mm);
  } else if (exact) {
    choice.stopped_by = "the residuals vanish to the resolution of the sums";
  } else if (finest) {
    choice.stopped_by = "the finest intervals of the sums";
  } else {
    choice.stopped_by = "Mallows' Cp stopped falling";
  }
  if (options.tolerance_mm > 0 && !held)
    choice.stopped_by += text("; the tolerance of %.3g mm was not reached (95th percentile %.3g mm)",
                              options.tolerance_mm, percentile(choice.fit));
  if (options.smoothing && varies && !exact && !held) {
    const double smoothed = smooth(choice.fit, penalty(*levels), 1e-7);
    // With smoothing, one refinement further than the samples alone carry may pay.
    const LadderLevels finer{variation.along_u ? levels->u - 1 : levels->u,
                             variation.around_v ? levels->v - 1 : levels->v};
    if (!options.fixed && choice.fit.smoothing > 0 && exists(finer, variation) &&
        affordable(finer, variation, {kSamplesPerUnknown, kProfilesPerUnknown}))
      if (auto other = solve_member(ladder_, finer, variation))
        if (smooth(*other, penalty(finer), choice.fit.smoothing / 10) < smoothed) choice.fit = std::move(*other);
  }
  if (options.fair_mm > 0 && varies) choice.stopped_by += fair(choice.fit, options.fair_mm);
  return choice;
}

}  // namespace celadon
