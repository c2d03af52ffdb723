// measure_errors: the last pass.
#include <cmath>
#include <optional>
#include <utility>

#include "fitting/cell_polynomials.h"
#include "fitting/error_histogram.h"
#include "fitting/fit_report.h"
#include "fitting/range_fit.h"
#include "fitting/residual_pass.h"
#include "fitting/robust_reference.h"

namespace celadon {

RangeFit measure_errors(SurfaceFit surface, ProfileStream& profiles) {
  const RobustReference* judge = surface.judge.get();
  RangeFit fit = std::move(surface.fit);
  RangeFitReport& report = fit.report;
  ErrorHistogram along_ray, geometric;
  const CellPolynomials polynomials(fit.function);
  const auto reference = judge ? std::optional<CellPolynomials>(judge->function()) : std::nullopt;
  const double low = fit.function.base().z_start_mm, high = fit.function.base().z_end_mm;
  std::size_t cut = 0;
  Residuals to_surface, to_reference;
  for (ResidualPass pass(profiles, fit.function.base().arcs); const Profile* p = pass.next();) {
    const std::size_t n = p->size();
    pass.compare(polynomials, to_surface, true);
    if (judge) pass.compare(*reference, to_reference, false);
    for (std::size_t k = 0; k < n; ++k) {
      const double z = p->z_mm[k];
      if (!pass.usable(k, surface.grid_start_mm, surface.grid_end_mm)) continue;
      if (judge) {
        const auto verdict = judge->verdict(pass.v()[k], z, p->r_mm[k], to_reference.residual[k]);
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
  warn(report, surface.band);
  return fit;
}

}  // namespace celadon
