#pragma once
// Splines of one parameter that shall have their knots in common.

#include <Eigen/Core>
#include <vector>

namespace celadon {

/// Splines on one knot vector, one a row of coefficients. Degree 0 is a constant: one coefficient over its whole range.
struct SplineRows {
  int degree = 0;
  std::vector<double> knots;  ///< clamped
  Eigen::MatrixXd coefficients;
};

/// Inserts knots into both until they agree; a constant takes the other's degree. The functions do not change.
/// @throws std::invalid_argument for different degrees, neither of which is 0
void share_knots(SplineRows& a, SplineRows& b);

}  // namespace celadon
