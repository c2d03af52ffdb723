#include "fitting/robust_least_squares.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

namespace celadon {
namespace {

constexpr double kTukeyFactor = 4.685;
constexpr int kMostSteps = 60;
constexpr double kStill = 1e-5;  // of the scale: a step that moves the shape so little is the last

}  // namespace

double median_scale(const Eigen::VectorXd& residuals, const Eigen::VectorXd& weights) {
  std::vector<double> sizes;
  sizes.reserve(static_cast<std::size_t>(residuals.size()));
  for (Eigen::Index k = 0; k < residuals.size(); ++k)
    if (weights[k] > 0) sizes.push_back(std::abs(residuals[k]));
  if (sizes.empty()) return 0;
  const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::nth_element(sizes.begin(), middle, sizes.end());
  return 1.4826 * *middle;
}

double tukey_weight(double residual, double scale) {
  const double t = residual / (kTukeyFactor * scale), u = 1 - t * t;
  return u > 0 ? u * u : 0;
}

double tukey_cost(const Eigen::VectorXd& residuals, const Eigen::VectorXd& weights, double scale) {
  const double c = kTukeyFactor * scale;
  double sum = 0;
  for (Eigen::Index k = 0; k < residuals.size(); ++k) {
    const double t = residuals[k] / c, u = std::max(0.0, 1 - t * t);
    sum += weights[k] * c * c / 6 * (1 - u * u * u);
  }
  return sum / weights.sum();
}

RobustSolution solve_robustly(const RobustProblem& problem, const Eigen::VectorXd& weights, double least_scale) {
  const Eigen::Index N = weights.size(), P = problem.unknowns;
  const auto counted = static_cast<double>((weights.array() > 0).count());
  const double freedom = counted > static_cast<double>(P) ? std::sqrt(counted / (counted - static_cast<double>(P))) : 1;
  const Eigen::VectorXd here = Eigen::VectorXd::Zero(P);
  RobustSolution solution;
  Eigen::VectorXd residuals(N), tried(N), applied(N), step;
  Eigen::MatrixXd J(N, P);
  problem.evaluate(here, residuals, &J);
  if (!residuals.allFinite()) return solution;
  double scale = 0, damping = 1e-4;
  bool follow = true;
  for (int round = 0; round < kMostSteps && !solution.converged; ++round) {
    // The scale follows the residuals until it hardly changes; then it stands still, so that the cost has a minimum.
    if (follow) {
      const double now = std::max(least_scale, freedom * median_scale(residuals, weights));
      follow = round < kMostSteps / 2 && std::abs(now - scale) > 0.01 * scale;
      scale = now;
    }
    for (Eigen::Index k = 0; k < N; ++k) applied[k] = weights[k] * tukey_weight(residuals[k], scale);
    const Eigen::MatrixXd A = J.transpose() * (applied.asDiagonal() * J);
    const Eigen::VectorXd b = -(J.transpose() * applied.cwiseProduct(residuals));
    const double cost = tukey_cost(residuals, weights, scale);
    bool lower = false;
    for (int attempt = 0; attempt < 12 && !lower; ++attempt) {
      Eigen::MatrixXd damped = A;
      damped.diagonal() += damping * A.diagonal().cwiseMax(1e-12 * A.diagonal().maxCoeff());
      step = damped.ldlt().solve(b);
      if (!step.allFinite()) return solution;
      problem.evaluate(step, tried, nullptr);
      // Equal within rounding is no step back.
      lower = tried.allFinite() && tukey_cost(tried, weights, scale) <= cost * (1 + 1e-14);
      damping = lower ? std::max(1e-12, damping / 10) : std::min(1e8, damping * 10);
    }
    if (!lower) {
      solution.converged = true;  // no way down that rounding does not hide
      break;
    }
    // What the step changes in the residuals, beside what they are.
    solution.converged = (J * step).norm() <= kStill * std::sqrt(counted) * scale;
    problem.accept(step);
    problem.evaluate(here, residuals, &J);
  }

  scale = std::max(least_scale, freedom * median_scale(residuals, weights));
  solution.scale = scale;
  Eigen::VectorXd slopes(N), squares(N);
  double inside = 0;
  for (Eigen::Index k = 0; k < N; ++k) {
    const double t = residuals[k] / (kTukeyFactor * scale), u = 1 - t * t;
    inside += u > 0 ? weights[k] : 0;
    slopes[k] = u > 0 ? weights[k] * u * (1 - 5 * t * t) : 0;
    squares[k] = u > 0 ? std::pow(weights[k] * u * u * residuals[k], 2) : 0;
  }
  solution.inliers = inside / weights.sum();
  const Eigen::MatrixXd H = J.transpose() * slopes.asDiagonal() * J;
  // Unknowns of different units: scaled to a unit diagonal before their rank is judged.
  const Eigen::VectorXd unit = H.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(unit.asDiagonal() * H * unit.asDiagonal());
  if (solver.info() == Eigen::Success && solver.eigenvalues()[0] > 1e-12 * solver.eigenvalues()[P - 1]) {
    const Eigen::MatrixXd inverse = unit.asDiagonal() * solver.eigenvectors() *
                                    solver.eigenvalues().cwiseInverse().asDiagonal() *
                                    solver.eigenvectors().transpose() * unit.asDiagonal();
    solution.covariance = inverse * (J.transpose() * squares.asDiagonal() * J) * inverse;
  }
  return solution;
}

}  // namespace celadon
