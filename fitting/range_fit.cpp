#include "fitting/range_fit.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <utility>

#include "fitting/cell_residuals.h"
#include "fitting/coefficient_covariance.h"
#include "fitting/coverage.h"
#include "fitting/fit_ladder.h"
#include "fitting/fit_report.h"
#include "fitting/knot_selection.h"
#include "fitting/model_selection.h"
#include "fitting/pole_choice.h"
#include "fitting/robust_reference.h"
#include "fitting/weighing.h"

namespace celadon {
namespace {

// What Tukey's weights leave of a normal distribution's variance: of the weighted residuals, and of the coefficients'
// scatter (moments of the biweight; README.md, "Weights").
constexpr double kC2 = kTukey * kTukey;
constexpr double kWeightMean = 1 - 2 / kC2 + 3 / (kC2 * kC2);
constexpr double kWeightedVariance = (1 - 6 / kC2 + 15 / (kC2 * kC2)) / kWeightMean;
constexpr double kCoefficientVariance =
    (1 - 12 / kC2 + 90 / (kC2 * kC2) - 420 / (kC2 * kC2 * kC2) + 945 / (kC2 * kC2 * kC2 * kC2)) / kWeightMean;

constexpr double kSamplesPerReferenceUnknown = 20, kProfilesPerReferenceUnknown = 3;
constexpr double kRelativeFormTolerance = 1e-9;
// z intervals of sums for a revolution alone, and rows of a profile for each of its unknowns at least.
constexpr int kMostAlongRevolution = 2048;
constexpr double kRowsPerUnknown = 1.5;
// Coefficients of a revolution scatter around by no more than so many standard deviations of a sample, on average.
constexpr double kRevolutionScales = 8;
// How far the samples may end from where the object goes on: cells, and a share of the band.
constexpr double kReachCells = 1.5, kReachShare = 0.02;
// Noise of the fit over the scatter about its robust reference, from which the wall may step.
constexpr double kSuspiciousNoise = 1.3;
constexpr double kAnyProfiles = std::numeric_limits<double>::infinity();

const char* const kUndetermined =
    "the samples do not determine the surface: they are too few or too unevenly spread; take more samples";

// The finest member with twenty samples an unknown and three profiles an unknown around; the coarsest if there is none.
LadderLevels reference_levels(const FitLadder& ladder, double samples, double profiles) {
  LadderLevels at;
  while (at.v + 1 < ladder.levels_v() &&
         kProfilesPerReferenceUnknown * ladder.unknowns(at.u, at.v, {false, true}) > profiles)
    ++at.v;
  while (kSamplesPerReferenceUnknown * ladder.unknowns(at.u, at.v) > samples) {
    const bool can_u = at.u + 1 < ladder.levels_u(), can_v = at.v + 1 < ladder.levels_v();
    if (!can_u && !can_v) break;
    if (can_u && (!can_v || ladder.intervals_u(at.u) >= 4 * ladder.intervals_per_arc(at.v))) {
      ++at.u;
    } else {
      ++at.v;
    }
  }
  return at;
}

double form_tolerance(const RangeFitOptions& options, const Eigen::MatrixXd& free, const CoveredBand& band) {
  if (options.form_tolerance_mm) return *options.form_tolerance_mm;
  if (options.systematic_mm > 0) return options.systematic_mm;
  const double height = options.base == BaseKind::sphere ? 0 : band.z_end_mm - band.z_start_mm;
  return kRelativeFormTolerance * std::max(2 * free.maxCoeff(), height);
}

// The levels of fixed numbers of intervals.
tl::expected<LadderLevels, FitError> fixed_levels(const MomentGrid& sums, const FitLadder& ladder,
                                                  const RangeFitOptions& options) {
  for (int u = 0; u < ladder.levels_u(); ++u)
    for (int v = 0; v < ladder.levels_v(); ++v)
      if (sums.z_cells() >> u == *options.z_intervals && ladder.intervals_per_arc(v) == *options.intervals_per_arc)
        return LadderLevels{u, v};
  return tl::unexpected(FitError{
      text("%d z intervals and %d an arc are not among those of the sums (%d and %d, halved any number of times)",
           *options.z_intervals, *options.intervals_per_arc, sums.z_cells(), sums.specification().intervals_per_arc)});
}

// Where samples are looked for and in which spaces; belongs to one set of sums.
struct Domain {
  const MomentGrid* sums;
  CoveredBand band;
  FitLadder ladder;
  LadderSearch search;
  Domain(const MomentGrid& s, const CoveredBand& b, const RangeFitOptions& options, double profiles)
      : sums(&s),
        band(b),
        ladder(s, b.cells, options.degree_u, options.degree_v, options.continuity),
        search(s, ladder, profiles) {}
  Domain(const Domain&) = delete;
  Domain& operator=(const Domain&) = delete;
};

// The band's ends go to where the object goes on.
std::optional<FitError> reach(CoveredBand& band, const MomentGrid& sums, const RangeFitOptions& options) {
  const auto& grid = sums.specification();
  const double cell = (grid.z_end_mm - grid.z_start_mm) / sums.z_cells();
  const double far = std::max(kReachCells * cell, kReachShare * (band.z_end_mm - band.z_start_mm));
  const auto edge = [&](double at) { return static_cast<int>(std::lround((at - grid.z_start_mm) / cell)); };
  const bool spherical = options.base == BaseKind::sphere;
  const auto short_of = [&](double to, double band_end) {
    const auto& meridian = BaseSurface::meridian();
    return spherical ? text(
                           "the head's samples end at a polar angle of %.3g degrees, short of its rim at %.3g; split "
                           "the object at another height, or scan what is missing",
                           meridian.theta_of_v(band_end) * 180 / std::numbers::pi,
                           meridian.theta_of_v(to) * 180 / std::numbers::pi)
                     : text(
                           "the body's samples end at z = %.6g mm, short of the split at %.6g mm; split the object at "
                           "another height, or scan what is missing",
                           band_end, to);
  };
  if (options.reach_start) {
    if (band.z_start_mm - *options.reach_start > std::max(far, options.hidden_start))
      return FitError{short_of(*options.reach_start, band.z_start_mm)};
    band.z_start_mm = *options.reach_start;
    band.cells.first = edge(band.z_start_mm);
  }
  if (options.reach_end) {
    if (*options.reach_end - band.z_end_mm > std::max(far, options.hidden_end))
      return FitError{short_of(*options.reach_end, band.z_end_mm)};
    band.z_end_mm = *options.reach_end;
    band.cells.last = edge(band.z_end_mm);
  }
  return std::nullopt;
}

tl::expected<std::unique_ptr<Domain>, FitError> make_domain(const MomentGrid& sums, const SectorExtents* extents,
                                                            const RangeFitOptions& options, bool whole_turn,
                                                            double profiles) {
  const FitLadder all(sums, {0, sums.z_cells()}, options.degree_u, options.degree_v, options.continuity);
  if (auto error = refuse_too_few(sums, all, options)) return tl::unexpected(*error);
  CoveredBand band = find_covered_band(sums, extents);
  band.cells.poles.rule = options.pole_rule.value_or(PoleRule::jet);
  if (auto error = refuse(band, whole_turn)) return tl::unexpected(*error);
  if (auto error = reach(band, sums, options)) return tl::unexpected(*error);
  return std::make_unique<Domain>(sums, band, options, profiles);
}

struct Noise {
  double variance = 0;
  Inflation inflation;
};

// Which model, by the samples or as given.
tl::expected<ModelDecision, FitError> decide_model(Domain& domain, const Noise& noise, const RangeFitOptions& options,
                                                   LadderLevels levels) {
  const auto reference = solve_member(domain.ladder, levels, {});
  if (!reference) return tl::unexpected(FitError{kUndetermined});
  ModelDecision decision =
      select_model(domain.ladder, {*reference->equations, reference->free, levels, noise.variance, noise.inflation},
                   form_tolerance(options, reference->free, domain.band));
  if (options.model != SurfaceModel::automatic) {
    decision.decided_by = text("%s: as given; left to the samples it would be %s",
                               to_string(options.model, options.base), to_string(decision.model, options.base));
    decision.model = options.model;
  }
  return decision;
}

// Sums of one arc's width, as fine along z as the rows of a profile are. nullopt: no finer than those there are.
std::optional<GridSpecification> revolution_grid(const MomentGrid& sums, const FirstLook& look,
                                                 const RangeFitOptions& options) {
  GridSpecification grid = sums.specification();
  const double points = static_cast<double>(look.points());
  const double rows = std::isfinite(look.profiles()) ? points / look.profiles() : std::sqrt(points);
  const auto most = static_cast<unsigned>(std::min<double>(kMostAlongRevolution, rows / kRowsPerUnknown));
  grid.z_intervals = static_cast<int>(std::bit_floor(most));
  grid.intervals_per_arc = 1;
  if (options.z_intervals || grid.z_intervals <= sums.z_cells()) return std::nullopt;
  return grid;
}

// The robust reference varies around by no more than noise and form tolerance explain.
bool may_be_revolution(const RobustReference& reference, const RangeFitOptions& options) {
  if (options.model == SurfaceModel::revolution) return true;
  const Eigen::MatrixXd& c = reference.function().coefficients();
  const double spread = (c.rowwise().maxCoeff() - c.rowwise().minCoeff()).mean();
  return spread <=
         kRevolutionScales * reference.scale_mm() + 2 * options.form_tolerance_mm.value_or(options.systematic_mm);
}

// The spaces of a revolution in its own sums, over the same band.
FitLadder ladder_along(const MomentGrid& sums, const CoveredBand& band, const RangeFitOptions& options) {
  const auto& grid = sums.specification();
  const double scale = sums.z_cells() / (grid.z_end_mm - grid.z_start_mm);
  const int first = std::clamp(static_cast<int>((band.z_start_mm - grid.z_start_mm) * scale), 0, sums.z_cells() - 1);
  const int last =
      std::clamp(static_cast<int>(std::ceil((band.z_end_mm - grid.z_start_mm) * scale)), first + 1, sums.z_cells());
  return {sums, {first, last, band.cells.poles}, options.degree_u, options.degree_v, options.continuity};
}

}  // namespace

tl::expected<RangeFit, FitError> fit_sums(const MomentGrid& sums, const RangeFitOptions& options) {
  if (auto error = refuse(sums, options)) return tl::unexpected(*error);
  auto domain = make_domain(sums, nullptr, options, false, kAnyProfiles);
  if (!domain) return tl::unexpected(domain.error());
  const FitLadder& ladder = (*domain)->ladder;
  LadderLevels levels = reference_levels(ladder, static_cast<double>(sums.samples()), kAnyProfiles);
  if (options.z_intervals) {
    const auto fixed = fixed_levels(sums, ladder, options);
    if (!fixed) return tl::unexpected(fixed.error());
    levels = *fixed;
  }
  auto member = solve_member(ladder, levels, {});
  if (!member) return tl::unexpected(FitError{kUndetermined});
  const double n = member->equations->weight();
  const Noise noise{member->residual_square / std::max(n - member->parameters, 0.05 * n), {}};

  RangeFit fit;
  ModelDecision decision =
      select_model(ladder, {*member->equations, member->free, levels, noise.variance, noise.inflation},
                   form_tolerance(options, member->free, (*domain)->band));
  fit.report.model = options.model == SurfaceModel::automatic ? decision.model : options.model;
  fit.report.decided_by = "preview: " + decision.decided_by;
  fit.report.stopped_by = "preview: the knots of the reference";
  fit.report.noise_mm = std::sqrt(noise.variance);
  if (fit.report.model != SurfaceModel::general) {
    member = solve_member(ladder, levels, variation_of(fit.report.model));
    if (!member) return tl::unexpected(FitError{kUndetermined});
  }
  const CoveredBand& band = (*domain)->band;
  fit.function = range_function(*member->equations, member->free).clipped(band.z_start_mm, band.z_end_mm);
  fit.surface = symbolic_product(fit.function);
  fit.report.points = sums.samples() + sums.rejected();
  fit.report.rejected = sums.rejected();
  fit.report.residual_mm.rms = std::sqrt(member->residual_square / n);
  describe(fit, band, sums);
  warn(fit, band);
  return fit;
}

tl::expected<SurfaceFit, FitError> fit_surface(const MomentGrid& sums, const FirstLook& look, ProfileParts parts,
                                               const RangeFitOptions& options, const Executor& executor,
                                               const std::function<void(const char* stage)>& stage, double share) {
  const auto enter = [&](const char* name) {
    if (stage) stage(name);
  };
  if (look.specification() != sums.specification())
    throw std::invalid_argument("fit_surface: the first look was over other sums");
  if (auto error = refuse(sums, options)) return tl::unexpected(*error);
  SurfaceFit result;
  RangeFitReport& report = result.fit.report;
  report.points = look.points();

  enter("looking for outliers");
  auto reference =
      std::make_shared<RobustReference>(sums, look, options.degree_u, options.degree_v, options.continuity, executor);
  const bool found = reference->fit(), reject = options.robust && found && reference->found_strangers();
  const bool reweight = reject || (look.has_covariances() && found);
  if (reject) result.judge = reference;
  auto domain = make_domain(sums, &look.extents(), options, true, look.profiles());
  if (!domain) return tl::unexpected(domain.error());

  // The noise is estimated where the fit predicts best; with weights, from the robust reference before them.
  enter(reweight ? "weighting the samples" : "estimating the noise");
  LadderSearch::Candidate candidate;
  RangeFunction noise_function = reference->function();
  double parameters = reference->unknowns(), around = reference->unknowns_around();
  if (!reweight) {
    candidate = (*domain)->search.best_for_white_noise();
    const auto fit = solve_member((*domain)->ladder, candidate.levels, candidate.variation);
    if (!fit) return tl::unexpected(FitError{kUndetermined});
    noise_function = range_function(*fit->equations, fit->free);
    parameters = fit->parameters;
    around = fit->equations->matrix().count_v();
  }
  WeighingTask task{.function = noise_function,
                    .judge = result.judge.get(),
                    .scale_mm = reference->scale_mm(),
                    .correlation = {.z_start_mm = noise_function.base().band_start,
                                    .z_end_mm = noise_function.base().band_end,
                                    .arcs = static_cast<double>(sums.arcs().count()),
                                    .samples = sums.samples(),
                                    .unknowns = static_cast<int>(parameters),
                                    .unknowns_around = static_cast<int>(around)},
                    .executor = executor};
  if (reweight) task.new_sums = look.has_covariances() ? WeightRule::covariance : WeightRule::unit;
  // A revolution may want finer intervals along z than sums that are as fine around can have.
  if (share == 1 && (reweight ? may_be_revolution(*reference, options) : candidate.levels.u == 0))
    task.revolution = revolution_grid(sums, look, options);
  Weighing weighing = weigh(sums, parts, task);
  double lack_of_fit = 0;
  if (reweight) {
    if (weighing.sums->samples() == 0)
      return tl::unexpected(
          FitError{"no samples belong to a common surface; check the input, or fit without robust weights"});
    domain = make_domain(*weighing.sums, &*weighing.extents, options, true, look.profiles());
    if (!domain) return tl::unexpected(domain.error());
    candidate = (*domain)->search.best_for_white_noise();
    const auto& member = (*domain)->search.member(candidate.levels, candidate.variation);
    if (!member.determined) return tl::unexpected(FitError{kUndetermined});
    const double samples = static_cast<double>(weighing.sums->samples());
    // The residuals were the robust reference's, which is coarser than the best member.
    lack_of_fit = 1 - member.residual_square / samples * weighing.weight / weighing.weighted_square;
    weighing.residual_square = member.residual_square;
    weighing.samples = samples;
    parameters = member.parameters;
    around = (*domain)->ladder.unknowns(candidate.levels.u, candidate.levels.v, {false, candidate.variation.around_v});
  }
  Inflation inflation = weighing.correlation.inflation(lack_of_fit);
  if (share < 1 && !reweight) {
    const auto member = solve_member((*domain)->ladder, candidate.levels, candidate.variation);
    weighing.residual_square = member->residual_square;
    weighing.samples = static_cast<double>(sums.samples());
    inflation = Inflation{.within = scattered_kappa(sums, *member)};
  }
  const double n = weighing.samples;
  const double lost = inflation.mean(parameters, around) * parameters;
  Noise noise{weighing.residual_square / std::max(n - lost, 0.5 * n), inflation};
  report.kappa = noise.inflation.total();
  report.noise_mm = std::sqrt(noise.variance / (reject ? kWeightedVariance : 1));
  if (reject) noise.variance *= kCoefficientVariance / kWeightedVariance;

  enter("choosing the model and the knots");
  const auto decision = decide_model(**domain, noise, options, reference_levels((*domain)->ladder, n, look.profiles()));
  if (!decision) return tl::unexpected(decision.error());
  LadderSearch::Options knots{.variation = variation_of(decision->model),
                              .noise_variance = noise.variance,
                              .inflation = noise.inflation,
                              .tolerance_mm = options.tolerance_mm,
                              .smoothing = options.smoothing,
                              .fair_mm = options.fair_mm,
                              .fixed = std::nullopt,
                              .percentile95 = {}};
  if (options.z_intervals) {
    const auto fixed = fixed_levels(*(*domain)->sums, (*domain)->ladder, options);
    if (!fixed) return tl::unexpected(fixed.error());
    knots.fixed = *fixed;
  }
  if (found) knots.percentile95 = [&](const RangeFunction& f) { return reference->percentile95(f); };
  auto choice = (*domain)->search.select(knots);
  std::optional<FitLadder> along;
  if (choice && choice->fit.levels.u == 0 && decision->model == SurfaceModel::revolution && weighing.revolution) {
    along.emplace(ladder_along(*weighing.revolution, (*domain)->band, options));
    choice = LadderSearch(*weighing.revolution, *along, look.profiles()).select(knots);
  }
  if (!choice) return tl::unexpected(FitError{kUndetermined});
  report.model = decision->model;
  report.decided_by = decision->decided_by;
  report.stopped_by = choice->stopped_by;
  const CoveredBand& band = (*domain)->band;
  PoleChoice poles;
  if (!options.pole_rule && band.cells.poles.any() && knots.variation.along_u && knots.variation.around_v) {
    poles = choose_poles((*domain)->ladder, options.degree_u, options.degree_v, options.continuity, look.profiles(),
                         knots, *choice);
    report.poles = poles.told;
    if (poles.level) choice = std::move(poles.level);
  }
  if (options.constraints.any()) {
    Variation variation = knots.variation;
    auto held = hold(options.constraints, along ? *along : (*domain)->ladder, band.z_start_mm, band.z_end_mm,
                     noise.variance, noise.inflation, choice->fit, variation);
    if (!held) return tl::unexpected(held.error());
    report.constraints = std::move(*held);
    if (variation.along_u != knots.variation.along_u)
      report.model = variation.around_v ? SurfaceModel::general : SurfaceModel::revolution;
  }
  RangeFit& fit = result.fit;
  fit.function = range_function(*choice->fit.equations, choice->fit.free).clipped(band.z_start_mm, band.z_end_mm);
  if (auto error = refuse_crossing(fit.function)) return tl::unexpected(*error);
  fit.surface = symbolic_product(fit.function);
  describe(fit, band, *(*domain)->sums);
  const MemberSamples samples{.sums = along ? *weighing.revolution : *(*domain)->sums,
                              .ladder = along                ? *along
                                        : poles.level_ladder ? *poles.level_ladder
                                                             : (*domain)->ladder,
                              .noise_variance = noise.variance,
                              .inflation = noise.inflation,
                              .profiles = look.profiles(),
                              .stated = reweight && look.has_covariances()};
  fit.errors = std::make_shared<const ErrorSources>(error_sources(samples, std::move(choice->fit)));
  if (options.base == BaseKind::cylinder && found && report.noise_mm > kSuspiciousNoise * reference->scale_mm())
    report.steps = find_steps(look.samples(), sums.arcs().count(), band.z_start_mm, band.z_end_mm);
  result.share = share;
  result.band = band;
  result.grid_start_mm = sums.specification().z_start_mm;
  result.grid_end_mm = sums.specification().z_end_mm;
  return result;
}

tl::expected<RangeFit, FitError> fit_range(const MomentGrid& sums, ProfileStream& profiles,
                                           const RangeFitOptions& options,
                                           const std::function<void(const char* stage)>& stage) {
  FirstLook look(sums);
  profiles.rewind();
  while (const Profile* profile = profiles.next()) look.add(*profile);
  ProfileStream* const whole[] = {&profiles};
  auto surface = fit_surface(sums, look, whole, options, run_in_turn, stage);
  if (!surface) return tl::unexpected(surface.error());
  if (stage) stage("errors of the surface");
  return measure_errors(std::move(*surface), whole);
}

tl::expected<RangeFit, FitError> fit_samples(ProfileStream& profiles, const RangeFitOptions& options) {
  const auto grid = choose_grid(profiles, options);
  if (!grid) return tl::unexpected(grid.error());
  const GatheredSamples gathered = gather(profiles, *grid);
  ProfileStream* const whole[] = {&profiles};
  auto surface = fit_surface(gathered.sums, gathered.look, whole, options);
  if (!surface) return tl::unexpected(surface.error());
  return measure_errors(std::move(*surface), whole);
}

}  // namespace celadon
