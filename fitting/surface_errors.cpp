// measure_errors: the last pass.
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "fitting/cell_polynomials.h"
#include "fitting/coefficient_covariance.h"
#include "fitting/error_histogram.h"
#include "fitting/fit_report.h"
#include "fitting/range_fit.h"
#include "fitting/residual_pass.h"
#include "fitting/robust_reference.h"

namespace celadon {

namespace {

ErrorSummary summary_of(const ErrorHistogram& errors) {
  return {errors.rms(), errors.quantile(0.95), errors.max()};
}

// Of one part of the samples.
struct PartErrors {
  SurfaceErrors missed;
  ErrorMap map;
  std::size_t cut = 0, unfollowable = 0;
};

// The surface, and what judges samples before they count.
struct Judged {
  const SurfaceFit& surface;
  CellPolynomials polynomials;
  std::optional<CellPolynomials> reference;
  explicit Judged(const SurfaceFit& s) : surface(s), polynomials(s.fit.function) {
    if (s.judge) reference.emplace(s.judge->function());
  }
};

PartErrors measure_part(const Judged& judged, ProfileStream& profiles) {
  PartErrors errors;
  errors.map = ErrorMap(judged.surface.fit.function.base());
  const SurfaceFit& surface = judged.surface;
  const BaseSurface& base = surface.fit.function.base();
  Residuals to_surface, to_reference;
  for (ResidualPass pass(profiles, base.arcs); const Profile* p = pass.next();) {
    pass.compare(judged.polynomials, to_surface, true);
    if (judged.reference) pass.compare(*judged.reference, to_reference, false);
    for (std::size_t k = 0; k < p->size(); ++k) {
      const double z = p->z_mm[k];
      if (!pass.usable(k, surface.grid_start_mm, surface.grid_end_mm)) continue;
      if (judged.reference) {
        const auto verdict = surface.judge->verdict(pass.v()[k], z, p->r_mm[k], to_reference.residual[k]);
        errors.unfollowable += verdict.kind == RobustReference::Kind::unfollowable;
        if (verdict.kind != RobustReference::Kind::good) continue;
      }
      if (z < base.band_start || z > base.band_end) {
        ++errors.cut;
        continue;
      }
      const double residual = to_surface.residual[k];
      errors.missed.along_ray.add(residual);
      const double geometric =
          residual * cos_psi(base, p->theta_rad[k], z, to_surface.r[k], to_surface.r_theta[k], to_surface.r_z[k]);
      errors.missed.geometric.add(geometric);
      errors.map.add(pass.v()[k], z, geometric);
    }
  }
  return errors;
}

}  // namespace

void SurfaceErrors::merge(const SurfaceErrors& other) {
  along_ray.merge(other.along_ray);
  geometric.merge(other.geometric);
}
ErrorSummary SurfaceErrors::along_ray_mm() const {
  return summary_of(along_ray);
}
ErrorSummary SurfaceErrors::geometric_mm() const {
  return summary_of(geometric);
}

RangeFit measure_errors(SurfaceFit surface, ProfileParts parts, const Executor& executor, SurfaceErrors* errors) {
  const Judged judged(surface);
  std::vector<PartErrors> of_part(parts.size());
  executor(static_cast<int>(parts.size()), [&](int k) {
    const auto at = static_cast<std::size_t>(k);
    of_part[at] = measure_part(judged, *parts[at]);
  });
  PartErrors& all = of_part.front();
  for (std::size_t k = 1; k < of_part.size(); ++k) {
    all.missed.merge(of_part[k].missed);
    all.map.merge(of_part[k].map);
    all.cut += of_part[k].cut;
    all.unfollowable += of_part[k].unfollowable;
  }
  RangeFitReport& report = surface.fit.report;
  const auto of_all = [&](std::size_t read) {
    return static_cast<std::size_t>(std::llround(static_cast<double>(read) / surface.share));
  };
  report.unfollowable = of_all(all.unfollowable);
  report.rejected = report.points - of_all(all.missed.along_ray.count() + all.cut + all.unfollowable);
  report.residual_mm = all.missed.along_ray_mm();
  report.geometric_mm = all.missed.geometric_mm();
  surface.fit.geometric_errors = std::move(all.map);
  if (errors) *errors = std::move(all.missed);
  const BaseSurface& base = surface.fit.function.base();
  if (surface.fit.errors)
    if (const auto covariance = CoefficientCovariance::of(*surface.fit.errors)) {
      const DeviationMap& map =
          surface.fit.deviation.emplace(deviation_map(*covariance, base.band_start, base.band_end));
      report.sd_mean_mm = map.mean(base);
      report.sd_max_mm = map.largest();
    }
  warn(surface.fit, surface.band);
  return std::move(surface.fit);
}

}  // namespace celadon
