#pragma once
// A shape as scanned points show it, and what their scatter leaves open of it. README.md, "Dimensions".

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/remeasured_points.h"
#include "daemon/shape_least_squares.h"
#include "fitting/robust_least_squares.h"

namespace celadon {

/// Number of the profile (points of one laser, table angle and stop) of each point, from 0 on.
std::vector<int> profiles_of(const ScannedPoints& points);

/// Covariance of the unknowns from the residuals, profiles as the units that are independent (Liang and Zeger 1986).
Eigen::MatrixXd scatter_covariance(const Eigen::MatrixXd& jacobian, const Eigen::VectorXd& weights,
                                   const Eigen::VectorXd& residuals, const std::vector<int>& profile);

/// Fewer than 30 points or 12 profiles tell no size with its uncertainty: the sentence that says so.
std::optional<std::string> too_few(const ScannedPoints& points);

template <class Shape>
struct MeasuredShape {
  Shape shape;
  Eigen::VectorXd weights;       ///< one a point: 1, or 0 where Tukey's biweight leaves it out
  Eigen::VectorXd residuals_mm;  ///< one a point
  Eigen::MatrixXd scatter;       ///< covariance of the shape's unknowns

  /// Derivative of values_of(shape) by the unknowns.
  template <class ValuesOf>
  Eigen::MatrixXd slopes(const ValuesOf& values_of) const {
    constexpr double kStep = 1e-6;
    Eigen::MatrixXd by(values_of(shape).size(), shape.unknowns());
    for (Eigen::Index j = 0; j < by.cols(); ++j) {
      Eigen::VectorXd step = Eigen::VectorXd::Zero(by.cols());
      step[j] = kStep;
      by.col(j) = (values_of(shape.moved(step)) - values_of(shape.moved(-step))) / (2 * kStep);
    }
    return by;
  }
};

/// Least squares over the points that Tukey's biweight keeps, from a shape that is near. Errors: points that do not
/// determine the shape. @pre one point or more
template <class Shape>
tl::expected<MeasuredShape<Shape>, std::string> measure_shape(Shape start, const ScannedPoints& points) {
  constexpr double kRounding_mm = 1e-9;
  constexpr const char* kUndetermined =
      "the points do not determine the shape: they show too small a part of it; scan more of its turn and height";
  const Eigen::Matrix3Xd& p = points.p_mm;
  MeasuredShape<Shape> out{std::move(start), Eigen::VectorXd(p.cols()), Eigen::VectorXd(p.cols()), {}};
  const RobustSolution found = fit_robustly(out.shape, p, Eigen::VectorXd::Ones(p.cols()).eval(), kRounding_mm);
  if (!found.converged || found.covariance.size() == 0) return tl::unexpected(std::string(kUndetermined));
  out.shape.residuals(p, out.residuals_mm, nullptr);
  for (Eigen::Index i = 0; i < p.cols(); ++i) {
    out.weights[i] = tukey_weight(out.residuals_mm[i], std::max(found.scale, kRounding_mm)) > 0 ? 1 : 0;
  }
  if (!least_squares(out.shape, p, out.weights, out.residuals_mm)) return tl::unexpected(std::string(kUndetermined));
  Eigen::MatrixXd jacobian(p.cols(), out.shape.unknowns());
  out.shape.residuals(p, out.residuals_mm, &jacobian);
  out.scatter = scatter_covariance(jacobian, out.weights, out.residuals_mm, profiles_of(points));
  return out;
}

}  // namespace celadon
