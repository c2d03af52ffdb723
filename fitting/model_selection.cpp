#include "fitting/model_selection.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <optional>
#include <vector>

#include "fitting/cell_residuals.h"
#include "fitting/coefficient_covariance.h"
#include "fitting/local_variance.h"

namespace celadon {
namespace {

// What both tests say of one simpler model.
struct Evidence {
  double mean_square = 0, allowed = 0;  // D2 and its bound, mm^2
  double largest = 0, critical = 0;     // (|F_g - F_s| - 3 delta)/sd and its bound
  bool mean_square_ok() const { return mean_square <= allowed; }
  bool largest_ok() const { return largest < critical; }
  bool accepted() const { return mean_square_ok() && largest_ok(); }
};

constexpr int kMostExact = 6000;   // unknowns up to which the inverse's entries are worth their time
constexpr double kUnseen = 1e300;  // where there are no samples nothing contradicts

// Two parameters an interval inside the band, with the values of its active functions there.
struct SamplePoints {
  std::vector<double> places;
  Eigen::MatrixXd values;    // points x free functions
  Eigen::VectorXd leverage;  // b' A^-1 b
};

// A of a space that varies in one direction only.
Eigen::MatrixXd marginal(const FitLadder& ladder, LadderLevels levels, Variation variation) {
  const NormalEquations equations = ladder.equations(levels.u, levels.v, variation);
  const int n = equations.matrix().size();
  Eigen::MatrixXd a(n, n), unit = Eigen::MatrixXd::Zero(equations.matrix().count_u(), equations.matrix().count_v());
  AlignedVector<double> product(equations.matrix().field_size());
  for (int k = 0; k < n; ++k) {
    unit.data()[k] = 1;
    equations.matrix().multiply(equations.to_field(unit).data(), product.data());
    unit.data()[k] = 0;
    const Eigen::MatrixXd column = equations.to_matrix(product);
    a.col(k) = Eigen::Map<const Eigen::VectorXd>(column.data(), n);
  }
  return a;
}

SamplePoints sample_points(const RangeSpace& space, const Eigen::MatrixXd& a) {
  SamplePoints points;
  points.values = Eigen::MatrixXd::Zero(2 * space.intervals(), space.free_count());
  for (int k = 0; k < space.intervals(); ++k)
    for (int side = 0; side < 2; ++side) {
      const double s = side ? 0.5 : -0.5;
      const double lo = space.breaks()[static_cast<std::size_t>(k)],
                   hi = space.breaks()[static_cast<std::size_t>(k) + 1];
      points.places.push_back((lo + hi) / 2 + s * (hi - lo) / 2);
      const auto active = space.active(k);
      for (std::size_t c = 0; c < active.size(); ++c) {
        const auto polynomial = space.polynomial(k, static_cast<int>(c));
        double value = 0;
        for (std::size_t i = polynomial.size(); i-- > 0;) value = value * s + polynomial[i];
        points.values(2 * k + side, active[c]) += value;
      }
    }
  // Functions without samples leave their points undetermined: an infinite leverage, not a failure.
  const double trace = a.trace();
  const Eigen::MatrixXd bounded =
      a + 1e-12 * trace / static_cast<double>(a.rows()) * Eigen::MatrixXd::Identity(a.rows(), a.cols());
  const Eigen::MatrixXd solved = bounded.ldlt().solve(points.values.transpose());
  points.leverage = (points.values.transpose().cwiseProduct(solved)).colwise().sum().transpose().cwiseMax(0);
  return points;
}

// How far a difference of two fits may go by chance, point by point: the same for all models.
class Deviations {
 public:
  /// `ratios`: variance of the samples over its mean, on the reference's intervals.
  Deviations(const FitLadder& ladder, const ReferenceFit& reference, const Eigen::MatrixXd& ratios) {
    of_even_noise(ladder, reference);
    for (Eigen::Index j = 0; j < sd_.cols(); ++j)
      for (Eigen::Index i = 0; i < sd_.rows(); ++i) sd_(i, j) *= std::sqrt(ratios(i / 2, j / 2));
  }
  double largest(const Eigen::MatrixXd& difference, double delta) const {
    const Eigen::MatrixXd value = u_.values * difference * v_.values.transpose();
    double result = 0;
    for (Eigen::Index k = 0; k < value.size(); ++k) {
      const double beyond = std::abs(value.data()[k]) - 3 * delta;
      if (beyond > 0) result = std::max(result, sd_.data()[k] > 0 ? beyond / sd_.data()[k] : 1e300);
    }
    return result;
  }

 private:
  void of_even_noise(const FitLadder& ladder, const ReferenceFit& reference) {
    const auto& equations = reference.equations;
    const Eigen::MatrixXd au = marginal(ladder, reference.levels, {true, false}),
                          av = marginal(ladder, reference.levels, {false, true});
    u_ = sample_points(equations.space().u, au);
    v_ = sample_points(equations.space().v, av);
    if (equations.empty_cells() > 0 && equations.matrix().size() <= kMostExact && around_holes(reference)) return;
    // The samples of a fit lie in both directions as their marginals say, A = Au x Av / N; where they are fewer, S^-1 A
    // S^-1 with S from the diagonal.
    const double n = equations.weight();
    Eigen::MatrixXd scale(au.rows(), av.rows());
    for (Eigen::Index j = 0; j < av.rows(); ++j)
      for (Eigen::Index i = 0; i < au.rows(); ++i) {
        const double d = equations.matrix().diagonal(static_cast<int>(i), static_cast<int>(j));
        scale(i, j) = d > 0 ? au(i, i) * av(j, j) / n / d : 1e300;
      }
    const Eigen::MatrixXd spread = u_.values * scale * v_.values.transpose();
    const Eigen::MatrixXd alone = n * (u_.leverage * v_.leverage.transpose());
    const Eigen::MatrixXd common = Eigen::VectorXd::Ones(u_.leverage.size()) * v_.leverage.transpose();
    sd_ = (spread.cwiseMax(0).cwiseProduct(reference.inflation.within * alone + reference.inflation.common * common) *
           reference.noise_variance)
              .cwiseSqrt();
  }
  // Beside holes a function may have all its samples in a corner: no product says what that leaves open.
  bool around_holes(const ReferenceFit& reference) {
    const auto covariance = CoefficientCovariance::of(
        even_error_sources(reference.equations, reference.free, reference.noise_variance, reference.inflation));
    if (!covariance) return false;
    sd_.resize(u_.values.rows(), v_.values.rows());
    for (Eigen::Index j = 0; j < sd_.cols(); ++j)
      for (Eigen::Index i = 0; i < sd_.rows(); ++i) {
        if (reference.equations.empty(static_cast<int>(i) / 2, static_cast<int>(j) / 2)) {
          sd_(i, j) = kUnseen;
          continue;
        }
        sd_(i, j) = covariance->sd_mm(v_.places[static_cast<std::size_t>(j)], u_.places[static_cast<std::size_t>(i)]);
      }
    return true;
  }
  SamplePoints u_, v_;
  Eigen::MatrixXd sd_;
};

std::string sentence(const char* model, const Evidence& e, double delta) {
  std::array<char, 320> text;
  const auto excess = [](double x) { return std::sqrt(std::max(x, 0.0)); };
  std::snprintf(text.data(), text.size(),
                "%s %s: it differs from the general fit by %.3g mm (RMS beyond noise; %.3g mm allowed) and at most by "
                "%.2g standard deviations beyond the form tolerance (%.2g allowed), form tolerance %.3g mm",
                model,
                e.accepted() ? "accepted"
                             : (e.mean_square_ok() ? "refused by the largest deviation" : "refused by the mean square"),
                excess(e.mean_square), excess(e.allowed), e.largest, e.critical, delta);
  return text.data();
}

}  // namespace

Variation variation_of(SurfaceModel model) {
  return {model != SurfaceModel::cylinder && model != SurfaceModel::translational,
          model != SurfaceModel::cylinder && model != SurfaceModel::revolution};
}

double normal_quantile(double upper_tail) {
  double lo = 0, hi = 40;
  for (int k = 0; k < 100; ++k) {
    const double x = (lo + hi) / 2;
    (std::erfc(x / std::sqrt(2.0)) / 2 > upper_tail ? lo : hi) = x;
  }
  return (lo + hi) / 2;
}

ModelDecision select_model(const FitLadder& ladder, const ReferenceFit& reference, double form_tolerance) {
  const NormalEquations& general = reference.equations;
  const double n = general.weight(), within = reference.inflation.within * reference.noise_variance,
               common = reference.inflation.common * reference.noise_variance;
  const int unknowns = general.supported_unknowns();
  // Noise is not alike everywhere; where weights come from stated covariances, those have seen to it.
  Eigen::MatrixXd ratios = Eigen::MatrixXd::Ones(general.space().u.intervals(), general.space().v.intervals());
  if (ladder.sums().rule() == WeightRule::unit)
    ratios = variance_ratios(cell_residuals(ladder.sums(), general, reference.free),
                             reference.inflation.mean(unknowns, general.matrix().count_v()) * unknowns,
                             general.mean_range());
  const double unevenness = ratios.array().square().mean() / std::pow(ratios.mean(), 2);
  const Deviations deviations(ladder, reference, ratios);
  const Eigen::MatrixXd gradient = general.gradient(reference.free);

  std::optional<SurfaceModel> chosen, statistical;
  std::string why, last_refusal;
  for (const SurfaceModel model : {SurfaceModel::cylinder, SurfaceModel::revolution, SurfaceModel::translational}) {
    // All around a closed pole there is one range only.
    if (model == SurfaceModel::translational && general.space().poles.any()) continue;
    const NormalEquations simple = ladder.equations(reference.levels.u, reference.levels.v, variation_of(model));
    const auto free = NormalSolver(simple).solve();
    if (!free) continue;
    // The functions of a direction sum to one: a constant has all coefficients equal.
    Eigen::MatrixXd difference = reference.free;
    for (Eigen::Index j = 0; j < difference.cols(); ++j)
      for (Eigen::Index i = 0; i < difference.rows(); ++i)
        difference(i, j) -= (*free)(free->rows() > 1 ? i : 0, free->cols() > 1 ? j : 0);
    // RSS_s - RSS_g without cancellation; the second term vanishes at the minimum.
    const double added = general.quadratic(difference) + 2 * difference.cwiseProduct(gradient).sum();
    // Errors common to a profile lie in the functions that are constant along z.
    const double dp = std::max(1, unknowns - simple.supported_unknowns()),
                 dp_around = general.matrix().count_v() - simple.matrix().count_v();
    const double variance = dp > 0 ? within + common * dp_around / dp : within;
    const double spread =
        2 * unevenness * (within * within * (dp - dp_around) + (within + common) * (within + common) * dp_around);
    const auto judge = [&](double delta) {
      Evidence e;
      e.mean_square = (added - variance * dp) / n;
      const double noncentral = 4 * n * delta * delta * variance;
      const double kappa_error = reference.inflation.total() > 1.05 ? 0.01 * dp * dp * variance * variance : 0;
      e.allowed = delta * delta + 3 / n * std::sqrt(spread + noncentral + kappa_error);
      e.largest = deviations.largest(difference, delta);
      e.critical = normal_quantile(5e-4 / unknowns);
      return e;
    };
    if (!statistical && judge(0).accepted()) statistical = model;
    if (!chosen) {
      const Evidence e = judge(form_tolerance);
      (e.accepted() ? why : last_refusal) = sentence(to_string(model, general.base()), e, form_tolerance);
      if (e.accepted()) chosen = model;
    }
  }
  ModelDecision decision;
  decision.model = chosen.value_or(SurfaceModel::general);
  decision.statistical = statistical.value_or(SurfaceModel::general);
  decision.decided_by = (chosen ? why : "general: every simpler model is contradicted (" + last_refusal + ")") +
                        "; without a form tolerance the samples alone say " +
                        to_string(decision.statistical, general.base());
  return decision;
}

}  // namespace celadon
