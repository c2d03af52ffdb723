#include "fitting/knot_selection.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <utility>

#include "fitting/prolongation.h"

namespace celadon {
namespace {

// Sums resolve residuals of this size relative to the range.
constexpr double kResolution = 2e-8;
// With fewer samples an unknown, Cp itself is too uncertain to choose by.
constexpr double kSamplesPerUnknown = 3;

// Refine the solution of a regularised system towards the plain least-squares one: the energy decides only what the
// samples leave open.
void remove_bias(const NormalEquations& equations, NormalSolver& solver, Eigen::MatrixXd& free) {
  for (int k = 0; k < 2; ++k)
    if (const auto step = solver.apply_inverse(equations.gradient(free))) free += *step;
}

class Search {
 public:
  Search(const MomentGrid& sums, const FitLadder& ladder, const ReferenceFit& reference, const KnotOptions& options)
      : sums_(sums), ladder_(ladder), reference_(reference), options_(options) {
    const double n = reference.equations.weight();
    penalty_ = 2 * reference.kappa * reference.noise_variance();
    const double resolved = kResolution * reference.equations.mean_range();
    floor_ = n * resolved * resolved;
  }

  struct Member {
    double cp = 0, percentile95 = 0;
    bool determined = false;
  };
  using Levels = std::pair<int, int>;

  bool allowed(Levels at) const {
    if (at.first < 0 || at.second < 0 || at.first >= ladder_.levels_u() || at.second >= ladder_.levels_v())
      return false;
    if (!options_.variation.along_u && at.first != ladder_.levels_u() - 1) return false;
    if (!options_.variation.around_v && at.second != ladder_.levels_v() - 1) return false;
    if (options_.level_u && at.first != *options_.level_u && options_.variation.along_u) return false;
    if (options_.level_v && at.second != *options_.level_v && options_.variation.around_v) return false;
    return true;
  }
  bool affordable(Levels at) const {
    return kSamplesPerUnknown * ladder_.unknowns(at.first, at.second, options_.variation) <=
           reference_.equations.weight();
  }

  const Member& evaluate(Levels at) {
    const auto [entry, fresh] = members_.try_emplace(at);
    if (!fresh) return entry->second;
    Member& member = entry->second;
    auto fit = solve_member(sums_, ladder_, at.first, at.second, options_.variation);
    if (!fit) return member;
    member.determined = true;
    fit->residual_square = residual_square(*fit);
    fit->cp = std::max(fit->residual_square, floor_) + penalty_ * fit->parameters;
    member.cp = fit->cp;
    if (options_.tolerance_mm > 0)
      member.percentile95 = options_.percentile95 ? options_.percentile95(range_function(*fit->equations, fit->free))
                                                  : 1.96 * std::sqrt(fit->residual_square / fit->equations->weight());
    if (!best_ || fit->cp < best_->cp) best_ = std::move(fit);
    return member;
  }

  // Nested in the reference: its exact residuals and what the difference adds; else from the sums.
  double residual_square(const LadderFit& fit) const {
    const auto& general = reference_.equations;
    if (fit.level_u < reference_.level_u || fit.level_v < reference_.level_v)
      return fit.equations->residual_square(fit.free);
    const auto &space = fit.equations->space(), &fine = general.space();
    const Eigen::MatrixXd difference = reference_.free - map(space.u, fine.u, prolong_u_, fit.level_u) * fit.free *
                                                             map(space.v, fine.v, prolong_v_, fit.level_v).transpose();
    return reference_.residual_square + general.quadratic(difference) +
           2 * difference.cwiseProduct(general.gradient(reference_.free)).sum();
  }

  std::optional<LadderFit> best_;
  std::map<Levels, Member> members_;
  double penalty_ = 0, floor_ = 0;

 private:
  using Maps = std::map<std::pair<int, int>, Eigen::MatrixXd>;
  static const Eigen::MatrixXd& map(const RangeSpace& coarse, const RangeSpace& fine, Maps& maps, int level) {
    const auto [entry, fresh] = maps.try_emplace({level, coarse.degree()});
    if (fresh) entry->second = prolongation(coarse, fine);
    return entry->second;
  }
  const MomentGrid& sums_;
  const FitLadder& ladder_;
  const ReferenceFit& reference_;
  const KnotOptions& options_;
  mutable Maps prolong_u_, prolong_v_;
};

std::string text(const char* format, double a, double b) {
  std::array<char, 240> buffer;
  std::snprintf(buffer.data(), buffer.size(), format, a, b);
  return buffer.data();
}

// Add bending energy as long as Cp falls: by factors of about three up from a trifle.
void smooth(LadderFit& fit, const Search& search, double start) {
  const auto& equations = *fit.equations;
  LadderFit best_values;
  bool found = false;
  double best_cp = fit.cp;
  int rises = 0;
  for (double weight = start; weight < 1 && rises < 2; weight *= std::sqrt(10.0)) {
    NormalSolver solver(equations, weight);
    const auto free = solver.solve();
    if (!free) break;
    const double rss = fit.residual_square + equations.quadratic(fit.free - *free) +
                       2 * (fit.free - *free).cwiseProduct(equations.gradient(fit.free)).sum();
    const double parameters = solver.effective_parameters();
    const double cp = std::max(rss, search.floor_) + search.penalty_ * parameters;
    if (cp < best_cp) {
      best_cp = cp;
      best_values.free = *free;
      best_values.smoothing = weight;
      best_values.residual_square = rss;
      best_values.parameters = parameters;
      found = true;
      rises = 0;
    } else if (found || cp > 1.05 * best_cp) {
      ++rises;
    }
  }
  if (!found) return;
  fit.free = best_values.free;
  fit.smoothing = best_values.smoothing;
  fit.residual_square = best_values.residual_square;
  fit.parameters = best_values.parameters;
  fit.cp = best_cp;
}

}  // namespace

std::optional<LadderFit> solve_member(const MomentGrid& sums, const FitLadder& ladder, int level_u, int level_v,
                                      Variation variation) {
  LadderFit fit;
  fit.equations = std::make_unique<NormalEquations>(sums, ladder.space(level_u, level_v, variation));
  fit.level_u = level_u;
  fit.level_v = level_v;
  const bool gaps = fit.equations->empty_cells() > 0;
  NormalSolver::Options options;
  options.direct = gaps;
  NormalSolver plain(*fit.equations, gaps ? kVanishingWeight : 0, options);
  auto free = plain.solve();
  if (free && gaps) remove_bias(*fit.equations, plain, *free);
  if (!free && !gaps) {  // full cells, yet too few samples in them
    NormalSolver bridged(*fit.equations, kVanishingWeight, {.direct = true});
    free = bridged.solve();
    if (free) remove_bias(*fit.equations, bridged, *free);
  }
  if (!free || !free->allFinite()) return std::nullopt;
  fit.free = std::move(*free);
  fit.parameters = fit.equations->supported_unknowns();
  fit.residual_square = fit.equations->residual_square(fit.free);
  return fit;
}

std::optional<LadderFit> select_knots(const MomentGrid& sums, const FitLadder& ladder, const ReferenceFit& reference,
                                      const KnotOptions& options) {
  Search search(sums, ladder, reference, options);
  const Search::Levels coarsest{
      options.level_u && options.variation.along_u ? *options.level_u : ladder.levels_u() - 1,
      options.level_v && options.variation.around_v ? *options.level_v : ladder.levels_v() - 1};
  const double tolerance = options.tolerance_mm;
  std::optional<Search::Levels> held;  // the first member that holds the tolerance
  const auto holds = [&](Search::Levels at) {
    return tolerance > 0 && search.evaluate(at).determined && search.evaluate(at).percentile95 <= tolerance;
  };

  // Both directions together, until Cp has risen twice in a row; then each direction alone from the best.
  Search::Levels at = coarsest, best = coarsest;
  double best_cp = 0;
  bool any = false;
  for (int rises = 0; rises < 2;) {
    const auto& member = search.evaluate(at);
    if (holds(at)) {
      held = at;
      break;
    }
    if (member.determined && (!any || member.cp < best_cp)) {
      best_cp = member.cp, best = at, any = true, rises = 0;
    } else {
      ++rises;
    }
    Search::Levels next{at.first - 1, at.second - 1};
    if (!search.allowed({next.first, at.second})) next.first = at.first;
    if (!search.allowed({at.first, next.second})) next.second = at.second;
    if (next == at || !search.affordable(next)) break;
    at = next;
  }
  if (held) {  // coarsen each direction while the tolerance holds
    for (bool moved = true; moved;) {
      moved = false;
      for (const Search::Levels& step : {Search::Levels{1, 0}, Search::Levels{0, 1}}) {
        const Search::Levels next{held->first + step.first, held->second + step.second};
        if (search.allowed(next) && holds(next)) held = next, moved = true;
      }
    }
    best = *held;
  } else if (any) {
    for (bool moved = true; moved;) {
      moved = false;
      for (const Search::Levels& step :
           {Search::Levels{1, 0}, Search::Levels{0, 1}, Search::Levels{-1, 0}, Search::Levels{0, -1}}) {
        const Search::Levels next{best.first + step.first, best.second + step.second};
        if (!search.allowed(next) || (step.first + step.second < 0 && !search.affordable(next))) continue;
        const auto& member = search.evaluate(next);
        if (member.determined && member.cp < best_cp) best_cp = member.cp, best = next, moved = true;
        if (holds(next) && !held) held = next;
      }
    }
    if (held) best = *held;
  }
  if (!any && !held) return std::nullopt;

  std::optional<LadderFit> result;
  if (search.best_ && search.best_->level_u == best.first && search.best_->level_v == best.second) {
    result = std::move(search.best_);
  } else {
    result = solve_member(sums, ladder, best.first, best.second, options.variation);
    if (!result) return std::nullopt;
    result->residual_square = search.residual_square(*result);
    result->cp = std::max(result->residual_square, search.floor_) + search.penalty_ * result->parameters;
  }
  const bool varies = options.variation.along_u || options.variation.around_v;
  const bool finest =
      (!options.variation.along_u || best.first == 0) && (!options.variation.around_v || best.second == 0);
  if (!varies) {
    result->stopped_by = "a cylinder has no knots to refine";
  } else if (options.level_u) {
    result->stopped_by = "intervals as given";
  } else if (held) {
    result->stopped_by =
        text("tolerance: 95th percentile %.3g mm within %.3g mm", search.evaluate(best).percentile95, tolerance);
  } else if (result->residual_square <= search.floor_) {
    result->stopped_by = "the residuals vanish to the resolution of the sums";
  } else if (finest) {
    result->stopped_by = "the finest intervals of the sums";
  } else {
    result->stopped_by = "Mallows' Cp stopped falling";
  }
  if (tolerance > 0 && !held && varies)
    result->stopped_by += text("; the tolerance of %.3g mm was not reached (95th percentile %.3g mm)", tolerance,
                               search.evaluate(best).percentile95);

  const bool noisy = result->residual_square > search.floor_;
  if (options.smoothing && varies && noisy && !held) {
    smooth(*result, search, 1e-7);
    // Smoothing may pay more with one refinement further than the samples alone carry.
    const Search::Levels finer{options.variation.along_u ? best.first - 1 : best.first,
                               options.variation.around_v ? best.second - 1 : best.second};
    if (!options.level_u && search.allowed(finer) && search.affordable(finer) && result->smoothing > 0)
      if (auto other = solve_member(sums, ladder, finer.first, finer.second, options.variation)) {
        other->residual_square = search.residual_square(*other);
        other->cp = std::max(other->residual_square, search.floor_) + search.penalty_ * other->parameters;
        smooth(*other, search, result->smoothing / 10);
        if (other->cp < result->cp) {
          other->stopped_by = result->stopped_by;
          result = std::move(other);
        }
      }
  }
  return result;
}

}  // namespace celadon
