#include "fitting/weighing.h"

#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "fitting/cell_polynomials.h"
#include "fitting/residual_pass.h"

namespace celadon {
namespace {

// Variance of r - F(theta, z) from a sample's covariance and the surface's slopes.
double residual_variance(const SampleCovariance& c, double r_theta, double r_z) {
  return c.rr + r_theta * r_theta * c.tt + r_z * r_z * c.zz - 2 * r_theta * c.rt - 2 * r_z * c.rz +
         2 * r_theta * r_z * c.tz;
}

Weighing weigh_part(const MomentGrid& sums, ProfileStream& profiles, const CellPolynomials& polynomials,
                    const WeighingTask& task) {
  Weighing result(task.correlation);
  if (task.new_sums) {
    result.sums.emplace(sums.specification(), *task.new_sums);
    result.extents.emplace(sums);
  }
  if (task.revolution) result.revolution.emplace(*task.revolution);
  const double low = task.function.base().band_start, high = task.function.base().band_end;
  Residuals to_function;
  std::vector<double> weight;
  for (ResidualPass pass(profiles, sums.arcs()); const Profile* p = pass.next();) {
    const std::size_t n = p->size();
    const bool by_covariance = task.new_sums == WeightRule::covariance && !p->covariance.empty();
    pass.compare(polynomials, to_function, by_covariance);
    auto& residual = to_function.residual;
    const std::vector<double>& v = pass.v();
    weight.assign(n, 0.0);
    for (std::size_t k = 0; k < n; ++k) {
      double relative = 1;
      if (pass.usable(k, low, high)) {
        weight[k] = task.judge ? task.judge->verdict(v[k], p->z_mm[k], p->r_mm[k], residual[k]).weight : 1;
        if (weight[k] > 0 && by_covariance) {
          const double variance = residual_variance(p->covariance[k], to_function.r_theta[k], to_function.r_z[k]);
          if (variance > 0) relative = task.scale_mm * task.scale_mm / variance;
          weight[k] *= relative;
        }
      }
      if (weight[k] > 0) {
        result.residual_square += residual[k] * residual[k];
        ++result.samples;
        result.weighted_square += weight[k] * residual[k] * residual[k];
        result.weight += weight[k];
        if (result.extents) result.extents->add(v[k], p->z_mm[k]);
        residual[k] *= std::sqrt(relative);  // correlation is that of errors of one variance
      } else {
        residual[k] = std::numeric_limits<double>::quiet_NaN();
      }
    }
    result.correlation.add(*p, v.data(), residual.data());
    if (result.sums) result.sums->add_synchronised(p->r_mm, v, p->z_mm, weight);
    if (result.revolution) result.revolution->add_synchronised(p->r_mm, v, p->z_mm, weight);
  }
  return result;
}

}  // namespace

void Weighing::merge(const Weighing& later) {
  residual_square += later.residual_square;
  samples += later.samples;
  weighted_square += later.weighted_square;
  weight += later.weight;
  correlation.merge(later.correlation);
  if (sums) sums->merge(*later.sums);
  if (extents) extents->merge(*later.extents);
  if (revolution) revolution->merge(*later.revolution);
}

Weighing weigh(const MomentGrid& sums, ProfileParts parts, const WeighingTask& task) {
  const CellPolynomials polynomials(task.function);
  std::vector<std::optional<Weighing>> of_part(parts.size());
  task.executor(static_cast<int>(parts.size()), [&](int k) {
    const auto at = static_cast<std::size_t>(k);
    of_part[at].emplace(weigh_part(sums, *parts[at], polynomials, task));
  });
  Weighing result = std::move(*of_part.front());
  for (std::size_t k = 1; k < of_part.size(); ++k) {
    result.merge(*of_part[k]);
    of_part[k].reset();
  }
  // Weights count samples: their mean is 1.
  for (auto* weighted : {&result.sums, &result.revolution})
    if (task.new_sums && *weighted && (*weighted)->samples() > 0)
      (*weighted)->scale(static_cast<double>((*weighted)->samples()) / (*weighted)->sum_weight());
  return result;
}

}  // namespace celadon
