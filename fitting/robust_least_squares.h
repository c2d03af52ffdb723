#pragma once
// Nonlinear least squares with Tukey's biweight: Levenberg and Marquardt's steps on reweighted residuals, the scale
// from the median. Source: README.md, "Frames".

#include <Eigen/Core>
#include <functional>

namespace celadon {

/// 1.4826 times the median of |residuals| over those of positive weight: the standard deviation of normal errors.
double median_scale(const Eigen::VectorXd& residuals, const Eigen::VectorXd& weights);
/// Tukey's biweight of residual/scale: 1 at 0, and 0 from 4.685 scales on. @pre scale > 0
double tukey_weight(double residual, double scale);
/// Weighted mean of Tukey's rho, residual^2/2 near 0, at a given scale: compares models of the same points.
double tukey_cost(const Eigen::VectorXd& residuals, const Eigen::VectorXd& weights, double scale);

struct RobustSolution {
  bool converged = false;
  double scale = 0;    ///< robust standard deviation of the residuals, less the unknowns
  double inliers = 0;  ///< share of the weight whose residuals are within 4.685 scales
  Eigen::MatrixXd
      covariance;  ///< of the unknowns (sandwich of the biweight's slopes); empty if they are not determined
};

/// Unknowns are local: they are steps away from a state, and zero is the state itself.
struct RobustProblem {
  int unknowns = 0;
  /// Residuals, and their Jacobian if asked for, at the state the step leads to; not finite where there is none.
  std::function<void(const Eigen::VectorXd& step, Eigen::VectorXd& residuals, Eigen::MatrixXd* jacobian)> evaluate;
  std::function<void(const Eigen::VectorXd& step)> accept;  ///< makes that state the current one
};

/// Goes downhill from the current state and leaves the lowest one it found.
/// @param weights one a residual, not negative  @param least_scale residuals below it are rounding; > 0
RobustSolution solve_robustly(const RobustProblem& problem, const Eigen::VectorXd& weights, double least_scale);

/// Fits a shape: a value with unknowns(), moved(step) and residuals(points, values, jacobian at itself).
template <class Shape>
RobustSolution fit_robustly(Shape& shape, const Eigen::Matrix3Xd& points, const Eigen::VectorXd& weights,
                            double least_scale) {
  return solve_robustly({shape.unknowns(),
                         [&](const Eigen::VectorXd& step, Eigen::VectorXd& residuals, Eigen::MatrixXd* jacobian) {
                           shape.moved(step).residuals(points, residuals, jacobian);
                         },
                         [&](const Eigen::VectorXd& step) { shape = shape.moved(step); }},
                        weights, least_scale);
}

}  // namespace celadon
