#include "fitting/coefficient_covariance.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <utility>
#include <vector>

#include "fitting/active_values.h"
#include "fitting/block_cholesky.h"
#include "fitting/cell_residuals.h"
#include "fitting/knot_bias.h"
#include "fitting/local_variance.h"
#include "fitting/pole_solver.h"

namespace celadon {
namespace {

// Step of the difference that gives M^-1 C M^-1, relative to the largest ratio of C to M: its square is the error.
constexpr double kStep = 0.03, kSmallestStep = 1e-4;
constexpr double kFew = 0.1;          // share of the usual samples under a function below which it counts as without
constexpr double kResolution = 1e-8;  // of the range, of residuals
// What solve_member's steps back towards least squares leave of the weight, nearly.
constexpr double kBridging = kVanishingWeight / 4;
constexpr double kRidge = 1e-12;

// A x = b, with what poles allow.
class Factor {
 public:
  Factor(const StencilMatrix& matrix, const PoleJets* jets) {
    if (jets) {
      pole_.emplace(matrix, *jets);
    } else {
      block_.emplace(matrix);
    }
  }
  bool ok() const { return pole_ ? pole_->ok() : block_->ok(); }
  void solve(const double* b, double* x) const { pole_ ? pole_->solve(b, x) : block_->solve(b, x); }

 private:
  std::optional<PoleSolver> pole_;
  std::optional<BlockCholesky> block_;
};

std::optional<StencilMatrix> inverse_entries(const StencilMatrix& matrix, const PoleJets* jets) {
  if (jets) {
    const PoleSolver factor(matrix, *jets);
    return factor.ok() ? std::optional(factor.inverse_entries()) : std::nullopt;
  }
  const BlockCholesky factor(matrix);
  return factor.ok() ? std::optional(factor.inverse_entries()) : std::nullopt;
}

// What errors common to a profile add: coefficients c(v) of functions that are constant along u scatter as A_v^-1, and
// the fit answers to them with M^-1 A T c, T = 1 x I. A column an unknown, its square the variance.
std::optional<Eigen::MatrixXd> common_errors(const NormalEquations& equations, const StencilMatrix& system) {
  const int nu = equations.matrix().count_u(), nv = equations.matrix().count_v();
  const Factor solver(system, equations.jets());
  if (!solver.ok()) return std::nullopt;
  Eigen::MatrixXd response(nv, nu * nv), around(nv, nv);
  AlignedVector<double> product(equations.matrix().field_size()), solved(product.size());
  for (int j = 0; j < nv; ++j) {
    Eigen::MatrixXd constant = Eigen::MatrixXd::Zero(nu, nv);
    constant.col(j).setOnes();
    equations.matrix().multiply(equations.to_field(constant).data(), product.data());
    const Eigen::MatrixXd of_samples = equations.to_matrix(product);
    around.row(j) = of_samples.colwise().sum();
    solver.solve(equations.to_field(of_samples).data(), solved.data());
    const Eigen::MatrixXd answer = equations.to_matrix(solved);
    response.row(j) = Eigen::Map<const Eigen::RowVectorXd>(answer.data(), answer.size());
  }
  around.diagonal().array() += kRidge * around.trace() / nv;
  const Eigen::LLT<Eigen::MatrixXd> factor(around);
  if (factor.info() != Eigen::Success) return std::nullopt;
  factor.matrixL().solveInPlace(response);
  return response;
}

StencilMatrix matrix_of(const NormalEquations& equations, const BendingEnergy& energy) {
  const StencilMatrix& a = equations.matrix();
  StencilMatrix matrix(a.count_u(), a.band_u(), a.count_v(), a.band_v());
  energy.add_to(matrix, 1);
  return matrix;
}

// tau: where there are samples, what Mallows' Cp has weighed against them, kappa sigma^2/mu; where there are none, the
// surface's own, which has the object's coarse bends in it too. `weighed`: of Cp, 0 if it has not smoothed.
Eigen::MatrixXd roughness(const NormalEquations& equations, const Eigen::MatrixXd& free, double weighed) {
  const StencilMatrix &a = equations.matrix(), e = matrix_of(equations, bending_energy(equations));
  const auto x = equations.to_field(free);
  AlignedVector<double> bent(x.size());
  e.multiply(x.data(), bent.data());
  double own = 0, usual = 0;  // of the surface; on the diagonal of A
  for (std::size_t k = 0; k < x.size(); ++k) own += x[k] * bent[k] / a.size();
  for (int j = 0; j < a.count_v(); ++j)
    for (int i = 0; i < a.count_u(); ++i) usual += a.diagonal(i, j) / a.size();
  if (weighed == 0) weighed = own;
  const double more = equations.empty_cells() > 0 ? std::max(0.0, own - weighed) : 0;
  Eigen::MatrixXd tau(a.count_u(), a.count_v());
  for (int j = 0; j < a.count_v(); ++j)
    for (int i = 0; i < a.count_u(); ++i) {
      const double missing = std::max(0.0, 1 - a.diagonal(i, j) / (kFew * usual));
      tau(i, j) = std::sqrt(weighed + missing * more);
    }
  return tau;
}

}  // namespace

ErrorSources even_error_sources(const NormalEquations& equations, const Eigen::MatrixXd& free, double noise_variance,
                                const Inflation& inflation) {
  ErrorSources sources;
  sources.equations = std::shared_ptr<const NormalEquations>(std::shared_ptr<const void>(), &equations);
  // No better than what sums resolve.
  const double resolved = kResolution * equations.mean_range();
  sources.noise_variance = sources.largest_variance = std::max(noise_variance, resolved * resolved);
  sources.noise = equations.matrix();
  sources.noise.scale(sources.noise_variance);
  sources.inflation = inflation;
  sources.knot_bias = Eigen::MatrixXd::Zero(free.rows(), free.cols());
  if (equations.empty_cells() > 0) {
    sources.smoothing = kBridging;
    sources.roughness = roughness(equations, free, 0);
  }
  return sources;
}

ErrorSources error_sources(const MemberSamples& samples, LadderFit member) {
  const NormalEquations& equations = *member.equations;
  ErrorSources sources = even_error_sources(equations, member.free, samples.noise_variance, samples.inflation);
  const double variance = sources.noise_variance,
               inflation = samples.inflation.mean(member.parameters, equations.matrix().count_v());
  if (member.smoothing > 0) {
    sources.smoothing = member.smoothing;
    const double mu = energy_factor(equations, bending_energy(equations), member.smoothing);
    sources.roughness = roughness(equations, member.free, mu > 0 ? inflation * variance / mu : 0);
  }
  const CellResiduals residuals = cell_residuals(samples.sums, equations, member.free);
  LocalNoise noise{variance, Eigen::MatrixXd::Ones(residuals.square.rows(), residuals.square.cols()),
                   samples.inflation};
  if (!samples.stated) {
    noise.ratios = variance_ratios(residuals, inflation * member.parameters, equations.mean_range());
    const MomentCells cells = residuals.moments.cells();
    AlignedVector<double> scaled(cells.sums, cells.cell(0, cells.count_v()));
    const auto stride = static_cast<std::size_t>(cells.layout.stride());
    for (std::size_t k = 0; k < scaled.size(); ++k) scaled[k] *= noise.ratios.data()[k / stride];
    sources.noise =
        NormalEquations(samples.sums, {cells.layout, cells.edges_z, cells.edges_v, scaled.data()}, equations.space())
            .matrix();
    sources.noise.scale(variance);
    sources.largest_variance = noise.ratios.maxCoeff() * variance;
  }
  sources.knot_bias = knot_bias(samples.ladder, samples.sums, member, noise, samples.profiles);
  if (!member.held.empty())
    sources.knot_bias_around = knot_bias(samples.ladder, samples.sums, member, noise, samples.profiles, {false, true})
                                   .cwiseMin(sources.knot_bias);
  sources.held = std::move(member.held);
  sources.equations = std::move(member.equations);
  return sources;
}

std::optional<CoefficientCovariance> CoefficientCovariance::of(const ErrorSources& sources) {
  const NormalEquations& equations = *sources.equations;
  const PoleJets* const jets = equations.jets();
  // M = A + mu E was solved. Of a truth whose bending loads E x have the covariance T E T, T = diag(tau), it makes the
  // error M^-1 (noise) - M^-1 mu E x, of covariance M^-1 C M^-1 with C = within N + mu^2 T E T.
  StencilMatrix system = equations.matrix(), errors = sources.noise;
  errors.scale(sources.inflation.within);
  double ratio = sources.inflation.within * sources.largest_variance;  // C <= ratio M, were tau the same everywhere
  if (sources.smoothing > 0) {
    const BendingEnergy energy = bending_energy(equations);
    const double mu = energy_factor(equations, energy, sources.smoothing);
    energy.add_to(system, mu);
    StencilMatrix loads = matrix_of(equations, energy);
    loads.scale_both_sides(mu * sources.roughness);
    errors.add(loads, 1);
    ratio = std::max(ratio, sources.roughness.array().square().maxCoeff() * mu);
  }
  if (!(ratio > 0)) return std::nullopt;
  std::optional<HeldErrors> held;
  if (!sources.held.empty()) {
    held.emplace(sources.held, equations.space().u, system, sources.knot_bias, sources.knot_bias_around);
    held->weigh_into(system);
  }
  // M^-1 C M^-1 is minus the derivative of (M + t C)^-1.
  std::optional<StencilMatrix> entries;
  for (double step = kStep; !entries && step > kSmallestStep; step /= 10) {
    const double t = step / ratio;
    StencilMatrix less = system, more = system;
    less.add(errors, -t);
    more.add(errors, t);
    entries = inverse_entries(less, jets);
    const auto subtracted = entries ? inverse_entries(more, jets) : std::nullopt;
    if (!subtracted) continue;
    entries->add(*subtracted, -1);
    entries->scale(1 / (2 * t));
  }
  if (!entries) return std::nullopt;
  const double common = sources.inflation.common * sources.noise_variance;
  if (common > 0) {
    auto of_profiles = common_errors(equations, system);
    if (!of_profiles) return std::nullopt;
    entries->add_product(*of_profiles * std::sqrt(common));
  }
  // As if the coefficients missed the truth by so much, all to one side: the functions add up to 1.
  if (!held)
    entries->add_product(Eigen::Map<const Eigen::RowVectorXd>(sources.knot_bias.data(), sources.knot_bias.size()));
  return CoefficientCovariance(sources.equations, std::move(*entries), std::move(held));
}

double CoefficientCovariance::sd_mm(double v, double along) const {
  const ActiveValues of_u(space().u, along), of_v(space().v, v);
  double variance = 0;
  for (std::size_t a = 0; a < of_v.count; ++a)
    for (std::size_t b = 0; b < of_v.count; ++b) {
      const int plane = entries_.plane_of(of_v.index[a], of_v.index[b]);
      double over_u = 0;
      for (std::size_t c = 0; c < of_u.count; ++c) {
        double row = 0;
        for (std::size_t d = 0; d < of_u.count; ++d)
          row += of_u.value[d] *
                 entries_.plane(plane, of_u.index[d] - of_u.index[c])[entries_.at(of_u.index[c], of_v.index[a])];
        over_u += of_u.value[c] * row;
      }
      variance += of_v.value[a] * of_v.value[b] * over_u;
    }
  if (held_) variance += held_->knots_square(of_u, of_v, along);
  return std::sqrt(std::max(variance, 0.0));
}

double CoefficientCovariance::sd_mm(double v, std::span<const AlongTerm> terms) const {
  std::vector<std::pair<int, double>> weights;  // of the functions along
  for (const AlongTerm& term : terms) {
    const ActiveValues values(space().u, term.along, term.order);
    for (std::size_t a = 0; a < values.count; ++a) {
      const auto known = std::find_if(weights.begin(), weights.end(),
                                      [&](const auto& weight) { return weight.first == values.index[a]; });
      const double more = term.factor * values.value[a];
      known == weights.end() ? static_cast<void>(weights.emplace_back(values.index[a], more))
                             : static_cast<void>(known->second += more);
    }
  }
  const ActiveValues of_v(space().v, v);
  double variance = 0;
  for (std::size_t a = 0; a < of_v.count; ++a)
    for (std::size_t b = 0; b < of_v.count; ++b) {
      const int plane = entries_.plane_of(of_v.index[a], of_v.index[b]);
      double over_u = 0;
      for (const auto& [c, of_c] : weights)
        for (const auto& [d, of_d] : weights)
          if (std::abs(d - c) <= entries_.band_u())
            over_u += of_c * of_d * entries_.plane(plane, d - c)[entries_.at(c, of_v.index[a])];
      variance += of_v.value[a] * of_v.value[b] * over_u;
    }
  return std::sqrt(std::max(variance, 0.0));
}

void CoefficientCovariance::evaluate(const double* v, const double* along, std::size_t n, double* sd) const {
  for (std::size_t k = 0; k < n; ++k) sd[k] = sd_mm(v[k], along[k]);
}

}  // namespace celadon
