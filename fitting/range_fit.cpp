#include "fitting/range_fit.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>

#include "fitting/coverage.h"
#include "fitting/error_histogram.h"
#include "fitting/fit_ladder.h"
#include "fitting/knot_selection.h"
#include "fitting/model_selection.h"
#include "fitting/noise_correlation.h"
#include "fitting/robust_reference.h"

namespace celadon {
namespace {

template <class... Values>
std::string text(const char* format, Values... values) {
  std::array<char, 500> buffer;
  std::snprintf(buffer.data(), buffer.size(), format, values...);
  return buffer.data();
}

// What Tukey's weights leave of a normal distribution's variance: of the weighted residuals, and of the coefficients'
// scatter (moments of the biweight at c = 4.685; README.md, "Weights").
constexpr double c2 = kTukey * kTukey;
constexpr double kWeightMean = 1 - 2 / c2 + 3 / (c2 * c2);
constexpr double kWeightedVariance = (1 - 6 / c2 + 15 / (c2 * c2)) / kWeightMean;
constexpr double kCoefficientVariance =
    (1 - 12 / c2 + 90 / (c2 * c2) - 420 / (c2 * c2 * c2) + 945 / (c2 * c2 * c2 * c2)) / kWeightMean;

// A reference needs this many samples an unknown.
constexpr double kSamplesPerReferenceUnknown = 20;
constexpr double kRelativeFormTolerance = 1e-9;

std::optional<FitError> refuse(const MomentGrid& sums, const RangeFitOptions& options) {
  const auto& grid = sums.specification();
  if (options.degree_u < 1 || options.degree_u > grid.degree_u || options.degree_v < 1 ||
      options.degree_v > grid.degree_v)
    return FitError{text("the degrees (%d, %d) are outside 1..(%d, %d), what the sums were made for", options.degree_u,
                         options.degree_v, grid.degree_u, grid.degree_v)};
  if (options.z_intervals.has_value() != options.intervals_per_arc.has_value())
    return FitError{"fixed numbers of intervals must be given for both directions or for none"};
  if (sums.samples() == 0 && sums.rejected() == 0)
    return FitError{"there are no samples; scan the object or name another input"};
  if (sums.samples() > 0) return std::nullopt;
  if (sums.rejected_on_axis() >= std::max(sums.rejected_not_finite(), sums.rejected_outside()))
    return FitError{
        text("all %zu samples lie on the axis (r = 0); check the axis and the units", sums.rejected_on_axis())};
  if (sums.rejected_not_finite() >= sums.rejected_outside())
    return FitError{text("none of the %zu samples is a finite number; check the input's format", sums.rejected())};
  return FitError{text("all %zu samples lie outside the band from z = %.6g to %.6g mm; widen the band", sums.rejected(),
                       grid.z_start_mm, grid.z_end_mm)};
}

std::optional<FitError> refuse(const CoveredBand& band, bool whole_turn) {
  if (band.sectors_with_samples == 0 || band.cells.first >= band.cells.last)
    return FitError{
        text("no height between z = %.6g and %.6g mm has samples all around (%d of %d sectors have any); scan the "
             "whole turn, or check the axis",
             band.lowest_mm, band.highest_mm, band.sectors_with_samples, band.sectors)};
  if (whole_turn && 2 * band.sectors_with_samples < band.sectors)
    return FitError{text("only %d of %d sectors around the axis have samples; scan at least half of the turn",
                         band.sectors_with_samples, band.sectors)};
  return std::nullopt;
}

// The finest member with twenty samples an unknown; the coarsest if there is none.
std::pair<int, int> reference_levels(const FitLadder& ladder, double samples) {
  int u = 0, v = 0;
  while (kSamplesPerReferenceUnknown * ladder.unknowns(u, v) > samples) {
    const bool can_u = u + 1 < ladder.levels_u(), can_v = v + 1 < ladder.levels_v();
    if (!can_u && !can_v) break;
    if (can_u && (!can_v || ladder.intervals_u(u) >= 4 * ladder.intervals_per_arc(v))) {
      ++u;
    } else {
      ++v;
    }
  }
  return {u, v};
}

std::optional<FitError> refuse_too_few(const MomentGrid& sums, const FitLadder& ladder,
                                       const RangeFitOptions& options) {
  const bool forced = options.model != SurfaceModel::automatic;
  const Variation variation = forced ? variation_of(options.model) : Variation{};
  const bool fixed = options.z_intervals.has_value();
  const int unknowns = fixed ? ladder.unknowns(0, 0, variation)
                             : ladder.unknowns(ladder.levels_u() - 1, ladder.levels_v() - 1, variation);
  if (sums.samples() >= static_cast<std::size_t>(unknowns)) return std::nullopt;
  return FitError{text("%zu samples are fewer than the %d unknowns of the %s %s surface; take more samples%s",
                       sums.samples(), unknowns, fixed ? "requested" : "smallest",
                       to_string(forced ? options.model : SurfaceModel::general),
                       fixed ? " or ask for fewer intervals" : " or ask for a simpler shape")};
}

double form_tolerance(const RangeFitOptions& options, const Eigen::MatrixXd& free, double height) {
  if (options.form_tolerance_mm) return *options.form_tolerance_mm;
  if (options.systematic_mm > 0) return options.systematic_mm;
  return kRelativeFormTolerance * std::max(2 * free.maxCoeff(), height);
}

// The levels of fixed numbers of intervals; nullopt if the grid does not have them.
std::optional<std::pair<int, int>> fixed_levels(const MomentGrid& sums, const FitLadder& ladder,
                                                const RangeFitOptions& options) {
  for (int u = 0; u < ladder.levels_u(); ++u)
    for (int v = 0; v < ladder.levels_v(); ++v)
      if (sums.z_cells() >> u == *options.z_intervals && ladder.intervals_per_arc(v) == *options.intervals_per_arc)
        return std::pair{u, v};
  return std::nullopt;
}

// Model, knots and smoothing from sums whose noise is known.
struct Decision {
  LadderFit fit;
  ModelDecision model;
};
tl::expected<Decision, FitError> decide(const MomentGrid& sums, const FitLadder& ladder, const ReferenceFit& reference,
                                        const RangeFitOptions& options, const KnotOptions& base) {
  Decision decision;
  const auto& breaks = reference.equations.space().u.breaks();
  decision.model =
      select_model(sums, ladder, reference, form_tolerance(options, reference.free, breaks.back() - breaks.front()));
  if (options.model != SurfaceModel::automatic) {
    decision.model.decided_by = text("%s: as given; left to the samples it would be %s", to_string(options.model),
                                     to_string(decision.model.model));
    decision.model.model = options.model;
  }
  KnotOptions knots = base;
  knots.variation = variation_of(decision.model.model);
  if (options.z_intervals) {
    const auto levels = fixed_levels(sums, ladder, options);
    if (!levels)
      return tl::unexpected(FitError{text(
          "%d z intervals and %d an arc are not among those of the sums (%d and %d, halved any "
          "number of times)",
          *options.z_intervals, *options.intervals_per_arc, sums.z_cells(), sums.specification().intervals_per_arc)});
    knots.level_u = levels->first;
    knots.level_v = levels->second;
  }
  auto fit = select_knots(sums, ladder, reference, knots);
  if (!fit)
    return tl::unexpected(FitError{
        "the samples do not determine the surface: they are too few or too unevenly spread; take more samples"});
  decision.fit = std::move(*fit);
  return decision;
}

// The profiles of a stream with their v, residuals to a function, and scratch; nothing is kept.
class Pass {
 public:
  Pass(ProfileStream& profiles, const BaseArcs& arcs) : profiles_(profiles), arcs_(arcs) { profiles_.rewind(); }
  const Profile* next() {
    const Profile* p = profiles_.next();
    if (!p) return nullptr;
    v.resize(p->size());
    arcs_.synchronise(p->theta_rad.data(), p->size(), v.data());
    for (std::size_t k = 0; k < p->size(); ++k)
      if (!std::isfinite(p->theta_rad[k])) v[k] = -1;
    return p;
  }
  void evaluate(const Profile& p, const RangeFunction& function) {
    residual.resize(p.size());
    function.evaluate(p.theta_rad.data(), p.z_mm.data(), p.size(), residual.data());
    for (std::size_t k = 0; k < p.size(); ++k) residual[k] = p.r_mm[k] - residual[k];
  }
  static bool finite(const Profile& p, std::size_t k, double v) {
    return p.r_mm[k] > 0 && std::isfinite(p.r_mm[k]) && std::isfinite(p.z_mm[k]) && v >= 0;
  }
  std::vector<double> v, residual;

 private:
  ProfileStream& profiles_;
  const BaseArcs& arcs_;
};

// Variance of r - F(theta, z) from a sample's covariance and the surface's slope.
double residual_variance(const SampleCovariance& c, const RangeDerivatives& f) {
  return c.rr + f.r_theta * f.r_theta * c.tt + f.r_z * f.r_z * c.zz - 2 * f.r_theta * c.rt - 2 * f.r_z * c.rz +
         2 * f.r_theta * f.r_z * c.tz;
}

void describe(RangeFit& fit, const CoveredBand& band, const MomentGrid& sums) {
  RangeFitReport& report = fit.report;
  report.degree_u = fit.surface.degree_u;
  report.degree_v = fit.surface.degree_v;
  report.control_points_u = fit.surface.count_u();
  report.control_points_v = fit.surface.count_v();
  report.z_start_mm = band.z_start_mm;
  report.z_end_mm = band.z_end_mm;
  report.cut_below_mm = std::max(0.0, band.z_start_mm - band.lowest_mm);
  report.cut_above_mm = std::max(0.0, band.highest_mm - band.z_end_mm);
  report.coverage = covered_share(sums, band);
}

void warn(RangeFitReport& report, const CoveredBand& band) {
  const auto share = [&](std::size_t n) {
    return 100.0 * static_cast<double>(n) / static_cast<double>(std::max<std::size_t>(report.points, 1));
  };
  const double height = band.z_end_mm - band.z_start_mm;
  if (band.sectors_with_samples < band.sectors)
    report.warnings.push_back(
        text("%d of %d sectors around the axis have no samples over most of the height; the surface bridges them.",
             band.sectors - band.sectors_with_samples, band.sectors));
  if (report.coverage < 0.95)
    report.warnings.push_back(
        text("%.1f %% of the surface has no samples and is bridged.", 100 * (1 - report.coverage)));
  if (report.unfollowable > 0)
    report.warnings.push_back(
        text("%zu samples (%.2f %%) lie on handles or undercuts that no single-valued surface can follow; they were "
             "left out.",
             report.unfollowable, share(report.unfollowable)));
  if (share(report.rejected) > 1)
    report.warnings.push_back(text("%zu samples (%.2f %%) were rejected as outliers or not usable.", report.rejected,
                                   share(report.rejected)));
  if (report.cut_below_mm > 0.005 * height)
    report.warnings.push_back(
        text("%.3g mm at the lower rim were measured but not all around, and are cut.", report.cut_below_mm));
  if (report.cut_above_mm > 0.005 * height)
    report.warnings.push_back(
        text("%.3g mm at the upper rim were measured but not all around, and are cut.", report.cut_above_mm));
}

}  // namespace

const char* to_string(SurfaceModel model) {
  switch (model) {
    case SurfaceModel::cylinder:
      return "cylinder";
    case SurfaceModel::revolution:
      return "revolution";
    case SurfaceModel::translational:
      return "translational";
    case SurfaceModel::general:
      return "general";
    case SurfaceModel::automatic:
      break;
  }
  return "auto";
}

tl::expected<RangeFit, FitError> fit_sums(const MomentGrid& sums, const RangeFitOptions& options) {
  if (auto error = refuse(sums, options)) return tl::unexpected(*error);
  const CoveredBand band = find_covered_band(sums, nullptr);
  if (auto error = refuse(band, false)) return tl::unexpected(*error);
  const FitLadder ladder(sums, band.cells, options.degree_u, options.degree_v, options.continuity);
  if (auto error = refuse_too_few(sums, ladder, options)) return tl::unexpected(*error);
  auto levels = reference_levels(ladder, static_cast<double>(sums.samples()));
  if (options.z_intervals) {
    const auto fixed = fixed_levels(sums, ladder, options);
    if (fixed) levels = *fixed;
  }
  auto member = solve_member(sums, ladder, levels.first, levels.second, {});
  if (!member) return tl::unexpected(FitError{"the samples do not determine the surface yet; take more samples"});
  const ReferenceFit reference{
      *member->equations, member->free, levels.first, levels.second, member->residual_square, 1};

  RangeFit fit;
  const double height = band.z_end_mm - band.z_start_mm;
  auto decision = select_model(sums, ladder, reference, form_tolerance(options, member->free, height));
  fit.report.model = options.model == SurfaceModel::automatic ? decision.model : options.model;
  fit.report.decided_by = "preview: " + decision.decided_by;
  fit.report.stopped_by = "preview: the knots of the reference";
  fit.report.noise_mm = std::sqrt(reference.noise_variance());
  if (fit.report.model != SurfaceModel::general) {
    auto simpler = solve_member(sums, ladder, levels.first, levels.second, variation_of(fit.report.model));
    if (!simpler) return tl::unexpected(FitError{"the samples do not determine the surface yet; take more samples"});
    member = std::move(simpler);
  }
  fit.function = range_function(*member->equations, member->free).clipped(band.z_start_mm, band.z_end_mm);
  fit.surface = symbolic_product(fit.function);
  fit.report.points = sums.samples() + sums.rejected();
  fit.report.rejected = sums.rejected();
  fit.report.residual_mm.rms =
      std::sqrt(member->equations->residual_square(member->free) / member->equations->weight());
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

  // First pass: a bounded sample for the robust reference, and how far the samples reach in every sector.
  enter("looking for outliers");
  RobustReference robust(sums, options.degree_u, options.degree_v, options.continuity);
  auto extents = std::make_unique<SectorExtents>(sums);
  bool covariances = false;
  const auto& grid = sums.specification();
  for (Pass pass(profiles, sums.arcs()); const Profile* p = pass.next();) {
    report.points += p->size();
    covariances = covariances || !p->covariance.empty();
    robust.add(*p, pass.v.data());
    for (std::size_t k = 0; k < p->size(); ++k)
      if (Pass::finite(*p, k, pass.v[k]) && p->z_mm[k] >= grid.z_start_mm && p->z_mm[k] <= grid.z_end_mm)
        extents->add(pass.v[k], p->z_mm[k]);
  }
  const bool fitted = robust.fit();
  const bool strangers = options.robust && fitted && robust.found_strangers();
  const bool weighted = strangers || (covariances && fitted);

  // The reference: from the sums as they are, or the robust one where they contain strangers.
  CoveredBand band = find_covered_band(sums, extents.get());
  if (auto error = refuse(band, true)) return tl::unexpected(*error);
  auto ladder = std::make_unique<FitLadder>(sums, band.cells, options.degree_u, options.degree_v, options.continuity);
  if (auto error = refuse_too_few(sums, *ladder, options)) return tl::unexpected(*error);
  auto levels = reference_levels(*ladder, static_cast<double>(sums.samples()));
  auto member = solve_member(sums, *ladder, levels.first, levels.second, {});
  if (!member)
    return tl::unexpected(FitError{
        "the samples do not determine the surface: they are too few or too unevenly spread; take more samples"});
  const RangeFunction first = weighted ? robust.function() : range_function(*member->equations, member->free);

  // Second pass: residuals of the reference, their correlation, and where needed new sums with weights.
  enter(weighted ? "weighting the samples" : "residuals of the reference");
  NoiseCorrelation correlation({.z_start_mm = first.base().z_start_mm,
                                .z_end_mm = first.base().z_end_mm,
                                .arcs = static_cast<double>(sums.arcs().count()),
                                .samples = sums.samples(),
                                .unknowns = member->equations->supported_unknowns(),
                                .unknowns_around = member->equations->space().v.free_count()});
  std::optional<MomentGrid> reweighted;
  if (weighted) {
    reweighted.emplace(grid, covariances ? WeightRule::covariance : WeightRule::unit);
    extents = std::make_unique<SectorExtents>(sums);
  }
  double residual_square = 0, weight_sum = 0;
  const double unit_variance = robust.scale_mm() * robust.scale_mm();
  std::vector<double> weight;
  for (Pass pass(profiles, sums.arcs()); const Profile* p = pass.next();) {
    pass.evaluate(*p, first);
    weight.assign(p->size(), 0.0);
    for (std::size_t k = 0; k < p->size(); ++k) {
      const double z = p->z_mm[k];
      const bool usable = Pass::finite(*p, k, pass.v[k]) && z >= grid.z_start_mm && z <= grid.z_end_mm;
      double& e = pass.residual[k];
      if (!usable || z < first.base().z_start_mm || z > first.base().z_end_mm) {
        e = std::numeric_limits<double>::quiet_NaN();
        continue;
      }
      weight[k] = 1;
      if (strangers) weight[k] = robust.verdict(pass.v[k], z, p->r_mm[k], e).weight;
      if (weight[k] > 0 && weighted && !p->covariance.empty()) {
        const double variance = residual_variance(p->covariance[k], first.derivatives(p->theta_rad[k], z));
        if (variance > 0 && unit_variance > 0) weight[k] *= unit_variance / variance;
      }
      if (weight[k] > 0) {
        residual_square += e * e;
        weight_sum += weight[k];
        if (weighted) extents->add(pass.v[k], z);
      } else {
        e = std::numeric_limits<double>::quiet_NaN();
      }
    }
    correlation.add(*p, pass.v.data(), pass.residual.data());
    if (weighted) reweighted->add(p->r_mm, p->theta_rad, p->z_mm, weight);
  }
  report.kappa = correlation.kappa();

  const MomentGrid& final_sums = weighted ? *reweighted : sums;
  double noise_factor = 1, coefficient_factor = 1;
  if (weighted) {
    if (reweighted->samples() == 0)
      return tl::unexpected(
          FitError{"no sample belongs to a common surface; check the input, or fit without robust weights"});
    // Weights count samples: their mean is 1.
    reweighted->scale(static_cast<double>(reweighted->samples()) / reweighted->sum_weight());
    band = find_covered_band(final_sums, extents.get());
    if (auto error = refuse(band, true)) return tl::unexpected(*error);
    ladder =
        std::make_unique<FitLadder>(final_sums, band.cells, options.degree_u, options.degree_v, options.continuity);
    levels = reference_levels(*ladder, static_cast<double>(final_sums.samples()));
    member = solve_member(final_sums, *ladder, levels.first, levels.second, {});
    if (!member)
      return tl::unexpected(
          FitError{"the samples left after rejecting outliers do not determine the surface; take more samples"});
    residual_square = member->residual_square;
    if (strangers) noise_factor = 1 / kWeightedVariance, coefficient_factor = kCoefficientVariance / kWeightedVariance;
  }

  enter("choosing the model and the knots");
  ReferenceFit reference{*member->equations, member->free, levels.first, levels.second, residual_square, report.kappa};
  report.noise_mm = std::sqrt(reference.noise_variance() * noise_factor);
  KnotOptions knots;
  knots.tolerance_mm = options.tolerance_mm;
  knots.smoothing = options.smoothing;
  if (fitted)
    knots.percentile95 = [&](const RangeFunction& f) {
      auto e = robust.absolute_residuals(f);
      if (e.empty()) return 0.0;
      const auto at = e.begin() + static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(e.size() - 1));
      std::nth_element(e.begin(), at, e.end());
      return *at;
    };
  reference.residual_square *= coefficient_factor;
  auto decision = decide(final_sums, *ladder, reference, options, knots);
  if (!decision) return tl::unexpected(decision.error());
  report.model = decision->model.model;
  report.decided_by = decision->model.decided_by;
  report.stopped_by = decision->fit.stopped_by;
  fit.function = range_function(*decision->fit.equations, decision->fit.free).clipped(band.z_start_mm, band.z_end_mm);
  fit.surface = symbolic_product(fit.function);

  // Third pass: what the surface misses by.
  enter("errors of the surface");
  ErrorHistogram along_ray, geometric;
  std::size_t used = 0, cut = 0;
  for (Pass pass(profiles, sums.arcs()); const Profile* p = pass.next();) {
    pass.evaluate(*p, fit.function);
    std::vector<double>& to_surface = pass.residual;
    std::vector<double> to_first;
    if (strangers) {
      to_first = to_surface;
      pass.evaluate(*p, first);
      std::swap(to_first, pass.residual);
    }
    for (std::size_t k = 0; k < p->size(); ++k) {
      const double z = p->z_mm[k];
      if (!Pass::finite(*p, k, pass.v[k]) || z < grid.z_start_mm || z > grid.z_end_mm) continue;
      if (strangers) {
        const auto verdict = robust.verdict(pass.v[k], z, p->r_mm[k], to_first[k]);
        if (verdict.kind == RobustReference::Kind::unfollowable) ++report.unfollowable;
        if (verdict.kind != RobustReference::Kind::good) continue;
      }
      if (z < band.z_start_mm || z > band.z_end_mm) {
        ++cut;
        continue;
      }
      ++used;
      const double e = to_surface[k];
      const RangeDerivatives f = fit.function.derivatives(p->theta_rad[k], z);
      const double slope_around = f.r_theta / f.r_mm;
      along_ray.add(e);
      geometric.add(e / std::sqrt(1 + f.r_z * f.r_z + slope_around * slope_around));
    }
  }
  report.rejected = report.points - used - cut - report.unfollowable;
  report.residual_mm = {along_ray.rms(), along_ray.quantile(0.95), along_ray.max()};
  report.geometric_mm = {geometric.rms(), geometric.quantile(0.95), geometric.max()};
  describe(fit, band, final_sums);
  warn(report, band);
  return fit;
}

}  // namespace celadon
