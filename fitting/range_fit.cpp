#include "fitting/range_fit.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <utility>

#include "fitting/coverage.h"
#include "fitting/error_histogram.h"
#include "fitting/fit_ladder.h"
#include "fitting/fit_report.h"
#include "fitting/knot_selection.h"
#include "fitting/model_selection.h"
#include "fitting/noise_correlation.h"
#include "fitting/residual_pass.h"
#include "fitting/robust_reference.h"

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
  return kRelativeFormTolerance * std::max(2 * free.maxCoeff(), band.z_end_mm - band.z_start_mm);
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

// Variance of r - F(theta, z) from a sample's covariance and the surface's slopes.
double residual_variance(const SampleCovariance& c, double r_theta, double r_z) {
  return c.rr + r_theta * r_theta * c.tt + r_z * r_z * c.zz - 2 * r_theta * c.rt - 2 * r_z * c.rz +
         2 * r_theta * r_z * c.tz;
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

tl::expected<std::unique_ptr<Domain>, FitError> make_domain(const MomentGrid& sums, const SectorExtents* extents,
                                                            const RangeFitOptions& options, bool whole_turn,
                                                            double profiles) {
  const FitLadder all(sums, {0, sums.z_cells()}, options.degree_u, options.degree_v, options.continuity);
  if (auto error = refuse_too_few(sums, all, options)) return tl::unexpected(*error);
  const CoveredBand band = find_covered_band(sums, extents);
  if (auto error = refuse(band, whole_turn)) return tl::unexpected(*error);
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
    decision.decided_by =
        text("%s: as given; left to the samples it would be %s", to_string(options.model), to_string(decision.model));
    decision.model = options.model;
  }
  return decision;
}

// First pass: a bounded sample for the robust reference, and how far the samples reach in every sector.
struct FirstLook {
  RobustReference robust;
  SectorExtents extents;
  std::size_t points = 0;
  double profiles = 0;  ///< lines of rows; infinite where points are scattered
  bool covariances = false, fitted = false;
};
FirstLook look(const MomentGrid& sums, ProfileStream& profiles, const RangeFitOptions& options) {
  FirstLook first{RobustReference(sums, options.degree_u, options.degree_v, options.continuity), SectorExtents(sums)};
  const auto& grid = sums.specification();
  for (ResidualPass pass(profiles, sums.arcs()); const Profile* p = pass.next();) {
    first.points += p->size();
    first.profiles += p->order == ProfileOrder::rows ? 1 : std::numeric_limits<double>::infinity();
    first.covariances = first.covariances || !p->covariance.empty();
    first.robust.add(*p, pass.v().data());
    for (std::size_t k = 0; k < p->size(); ++k)
      if (pass.usable(k, grid.z_start_mm, grid.z_end_mm)) first.extents.add(pass.v()[k], p->z_mm[k]);
  }
  first.fitted = first.robust.fit();
  return first;
}

// Sums of one arc's width, as fine along z as the rows of a profile are. nullopt: no finer than those there are.
std::optional<GridSpecification> revolution_grid(const MomentGrid& sums, const FirstLook& first,
                                                 const RangeFitOptions& options) {
  GridSpecification grid = sums.specification();
  const double rows = std::isfinite(first.profiles) ? static_cast<double>(first.points) / first.profiles
                                                    : std::sqrt(static_cast<double>(first.points));
  const auto most = static_cast<unsigned>(std::min<double>(kMostAlongRevolution, rows / kRowsPerUnknown));
  grid.z_intervals = static_cast<int>(std::bit_floor(most));
  grid.intervals_per_arc = 1;
  if (options.z_intervals || grid.z_intervals <= sums.z_cells()) return std::nullopt;
  return grid;
}

// The knots of a revolution from its own sums, over the same band.
std::optional<LadderSearch::Choice> select_along(const MomentGrid& sums, const CoveredBand& band,
                                                 const RangeFitOptions& options, double profiles,
                                                 const LadderSearch::Options& knots) {
  const auto& grid = sums.specification();
  const double scale = sums.z_cells() / (grid.z_end_mm - grid.z_start_mm);
  const int first = std::clamp(static_cast<int>((band.z_start_mm - grid.z_start_mm) * scale), 0, sums.z_cells() - 1);
  const int last =
      std::clamp(static_cast<int>(std::ceil((band.z_end_mm - grid.z_start_mm) * scale)), first + 1, sums.z_cells());
  const FitLadder ladder(sums, {first, last}, options.degree_u, options.degree_v, options.continuity);
  return LadderSearch(sums, ladder, profiles).select(knots);
}

// Second pass: residuals of a function, their correlation, and where asked for new sums with weights.
struct Weighing {
  explicit Weighing(const NoiseCorrelation::Setting& setting) : correlation(setting) {}
  double residual_square = 0, samples = 0;
  NoiseCorrelation correlation;
  std::optional<MomentGrid> sums;
  std::optional<SectorExtents> extents;
  std::optional<MomentGrid> revolution;
};
Weighing weigh(const MomentGrid& sums, ProfileStream& profiles, const FirstLook& first, const RangeFunction& function,
               bool reject, bool reweight, const std::optional<GridSpecification>& revolution,
               const NoiseCorrelation::Setting& setting) {
  Weighing result(setting);
  if (reweight) {
    result.sums.emplace(sums.specification(), first.covariances ? WeightRule::covariance : WeightRule::unit);
    result.extents.emplace(sums);
  }
  if (revolution) result.revolution.emplace(*revolution);
  const double scale = first.robust.scale_mm(), low = function.base().z_start_mm, high = function.base().z_end_mm;
  const CellPolynomials polynomials(function);
  Residuals to_function;
  std::vector<double> weight;
  for (ResidualPass pass(profiles, sums.arcs()); const Profile* p = pass.next();) {
    const std::size_t n = p->size();
    const bool by_covariance = reweight && !p->covariance.empty();
    pass.compare(polynomials, to_function, by_covariance);
    auto& residual = to_function.residual;
    weight.assign(n, 0.0);
    for (std::size_t k = 0; k < n; ++k) {
      if (pass.usable(k, low, high)) {
        weight[k] = reject ? first.robust.verdict(pass.v()[k], p->z_mm[k], p->r_mm[k], residual[k]).weight : 1;
        if (weight[k] > 0 && by_covariance) {
          const double variance = residual_variance(p->covariance[k], to_function.r_theta[k], to_function.r_z[k]);
          if (variance > 0) weight[k] *= scale * scale / variance;
        }
      }
      if (weight[k] > 0) {
        result.residual_square += residual[k] * residual[k];
        ++result.samples;
        if (reweight) result.extents->add(pass.v()[k], p->z_mm[k]);
      } else {
        residual[k] = std::numeric_limits<double>::quiet_NaN();
      }
    }
    result.correlation.add(*p, pass.v().data(), residual.data());
    if (reweight) result.sums->add(p->r_mm, p->theta_rad, p->z_mm, weight);
    if (result.revolution) result.revolution->add(p->r_mm, p->theta_rad, p->z_mm, weight);
  }
  // Weights count samples: their mean is 1.
  for (auto* weighted : {&result.sums, &result.revolution})
    if (reweight && *weighted && (*weighted)->samples() > 0)
      (*weighted)->scale(static_cast<double>((*weighted)->samples()) / (*weighted)->sum_weight());
  return result;
}

// Third pass: what the surface misses by. `reject` judges by the robust reference, as the weights did.
void measure(RangeFit& fit, const MomentGrid& sums, ProfileStream& profiles, const FirstLook& first, bool reject) {
  RangeFitReport& report = fit.report;
  ErrorHistogram along_ray, geometric;
  const CellPolynomials polynomials(fit.function);
  const auto reference = reject ? std::optional<CellPolynomials>(first.robust.function()) : std::nullopt;
  const auto& grid = sums.specification();
  const double low = fit.function.base().z_start_mm, high = fit.function.base().z_end_mm;
  std::size_t cut = 0;
  Residuals to_surface, to_reference;
  for (ResidualPass pass(profiles, sums.arcs()); const Profile* p = pass.next();) {
    const std::size_t n = p->size();
    pass.compare(polynomials, to_surface, true);
    if (reject) pass.compare(*reference, to_reference, false);
    for (std::size_t k = 0; k < n; ++k) {
      const double z = p->z_mm[k];
      if (!pass.usable(k, grid.z_start_mm, grid.z_end_mm)) continue;
      if (reject) {
        const auto verdict = first.robust.verdict(pass.v()[k], z, p->r_mm[k], to_reference.residual[k]);
        report.unfollowable += verdict.kind == RobustReference::Kind::unfollowable;
        if (verdict.kind != RobustReference::Kind::good) continue;
      }
      if (z < low || z > high) {
        ++cut;
        continue;
      }
      const double residual = to_surface.residual[k], r_z = to_surface.r_z[k];
      const double around = to_surface.r_theta[k] / to_surface.r[k];
      along_ray.add(residual);
      geometric.add(residual / std::sqrt(1 + r_z * r_z + around * around));
    }
  }
  report.rejected = report.points - along_ray.count() - cut - report.unfollowable;
  report.residual_mm = {along_ray.rms(), along_ray.quantile(0.95), along_ray.max()};
  report.geometric_mm = {geometric.rms(), geometric.quantile(0.95), geometric.max()};
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
  warn(fit.report, band);
  return fit;
}

tl::expected<RangeFit, FitError> fit_range(const MomentGrid& sums, ProfileStream& profiles,
                                           const RangeFitOptions& options,
                                           const std::function<void(const char* stage)>& stage) {
  const auto enter = [&](const char* name) {
    if (stage) stage(name);
  };
  if (auto error = refuse(sums, options)) return tl::unexpected(*error);
  RangeFit fit;
  RangeFitReport& report = fit.report;

  enter("looking for outliers");
  const FirstLook first = look(sums, profiles, options);
  report.points = first.points;
  const bool reject = options.robust && first.fitted && first.robust.found_strangers();
  const bool reweight = reject || (first.covariances && first.fitted);
  auto domain = make_domain(sums, &first.extents, options, true, first.profiles);
  if (!domain) return tl::unexpected(domain.error());

  // The noise is estimated where the fit predicts best, or from the robust reference where there are strangers.
  enter(reweight ? "weighting the samples" : "estimating the noise");
  auto candidate = (*domain)->search.best_for_white_noise();
  const auto candidate_fit = solve_member((*domain)->ladder, candidate.levels, candidate.variation);
  if (!candidate_fit) return tl::unexpected(FitError{kUndetermined});
  const RangeFunction noise_function =
      reweight ? first.robust.function() : range_function(*candidate_fit->equations, candidate_fit->free);
  // A revolution may want finer intervals along z than sums that are as fine around can have.
  const bool refine = reweight || candidate.levels.u == 0;
  const auto fine = refine ? revolution_grid(sums, first, options) : std::nullopt;
  Weighing weighing = weigh(sums, profiles, first, noise_function, reject, reweight, fine,
                            {.z_start_mm = noise_function.base().z_start_mm,
                             .z_end_mm = noise_function.base().z_end_mm,
                             .arcs = static_cast<double>(sums.arcs().count()),
                             .samples = sums.samples(),
                             .unknowns = static_cast<int>(candidate_fit->parameters),
                             .unknowns_around = candidate_fit->equations->space().v.free_count()});
  double parameters = candidate_fit->parameters, around = candidate_fit->equations->matrix().count_v(), lack_of_fit = 0;
  if (reweight) {
    if (weighing.sums->samples() == 0)
      return tl::unexpected(
          FitError{"no samples belong to a common surface; check the input, or fit without robust weights"});
    domain = make_domain(*weighing.sums, &*weighing.extents, options, true, first.profiles);
    if (!domain) return tl::unexpected(domain.error());
    candidate = (*domain)->search.best_for_white_noise();
    const auto& member = (*domain)->search.member(candidate.levels, candidate.variation);
    const double samples = static_cast<double>(weighing.sums->samples());
    // The residuals were the robust reference's, which is coarser than the best member.
    lack_of_fit = 1 - member.residual_square / samples * weighing.samples / weighing.residual_square;
    weighing.residual_square = member.residual_square;
    weighing.samples = samples;
    parameters = member.parameters;
    around = (*domain)->ladder.unknowns(candidate.levels.u, candidate.levels.v, {false, candidate.variation.around_v});
  }
  const double n = weighing.samples;
  const Inflation inflation = weighing.correlation.inflation(lack_of_fit);
  const double lost = inflation.mean(parameters, around) * parameters;
  Noise noise{weighing.residual_square / std::max(n - lost, 0.5 * n), inflation};
  report.kappa = noise.inflation.total();
  report.noise_mm = std::sqrt(noise.variance / (reject ? kWeightedVariance : 1));
  if (reject) noise.variance *= kCoefficientVariance / kWeightedVariance;

  enter("choosing the model and the knots");
  const auto decision = decide_model(**domain, noise, options, reference_levels((*domain)->ladder, n, first.profiles));
  if (!decision) return tl::unexpected(decision.error());
  LadderSearch::Options knots{.variation = variation_of(decision->model),
                              .noise_variance = noise.variance,
                              .inflation = noise.inflation,
                              .tolerance_mm = options.tolerance_mm,
                              .smoothing = options.smoothing,
                              .fixed = std::nullopt,
                              .percentile95 = {}};
  if (options.z_intervals) {
    const auto fixed = fixed_levels(*(*domain)->sums, (*domain)->ladder, options);
    if (!fixed) return tl::unexpected(fixed.error());
    knots.fixed = *fixed;
  }
  if (first.fitted) knots.percentile95 = [&](const RangeFunction& f) { return first.robust.percentile95(f); };
  auto choice = (*domain)->search.select(knots);
  if (choice && choice->fit.levels.u == 0 && decision->model == SurfaceModel::revolution && weighing.revolution)
    choice = select_along(*weighing.revolution, (*domain)->band, options, first.profiles, knots);
  if (!choice) return tl::unexpected(FitError{kUndetermined});
  report.model = decision->model;
  report.decided_by = decision->decided_by;
  report.stopped_by = choice->stopped_by;
  const CoveredBand& band = (*domain)->band;
  fit.function = range_function(*choice->fit.equations, choice->fit.free).clipped(band.z_start_mm, band.z_end_mm);
  fit.surface = symbolic_product(fit.function);

  enter("errors of the surface");
  measure(fit, sums, profiles, first, reject);
  describe(fit, band, *(*domain)->sums);
  warn(report, band);
  return fit;
}

}  // namespace celadon
