#pragma once
// Least squares of a round shape's distances to points, plain: smooth in the points, as differences need it.

#include <Eigen/Dense>

namespace celadon {

/// Gauss and Newton's steps from a shape that is near. @returns whether they settled on finite residuals
/// @param weights    one a point
/// @param residuals  of the result
template <class Shape>
bool least_squares(Shape& shape, const Eigen::Matrix3Xd& points, const Eigen::VectorXd& weights,
                   Eigen::VectorXd& residuals) {
  constexpr int kMostSteps = 20;
  constexpr double kStill = 1e-10;
  residuals.resize(points.cols());
  Eigen::MatrixXd jacobian(points.cols(), shape.unknowns());
  bool settled = false;
  for (int k = 0; k < kMostSteps && !settled; ++k) {
    shape.residuals(points, residuals, &jacobian);
    const Eigen::MatrixXd normal = jacobian.transpose() * weights.asDiagonal() * jacobian;
    const Eigen::VectorXd step = -normal.ldlt().solve(jacobian.transpose() * weights.cwiseProduct(residuals));
    if (!step.allFinite()) return false;
    shape = shape.moved(step);
    settled = step.cwiseAbs().maxCoeff() < kStill;
  }
  shape.residuals(points, residuals, nullptr);
  return settled && residuals.allFinite();
}

}  // namespace celadon
