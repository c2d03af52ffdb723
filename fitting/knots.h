#pragma once
// Knot vectors: breaks with multiplicities, clamped vectors, knot insertion as a linear map.
// Source: thesis (A.4), (A.5); Boehm's insertion. README.md, "Knots".

#include <Eigen/SparseCore>
#include <span>
#include <vector>

namespace celadon {

/// The distinct knots of a vector and how often each occurs.
struct Breaks {
  std::vector<double> values;
  std::vector<int> multiplicities;  ///< same length
};

/// @pre knots ascending
Breaks breaks_of(std::span<const double> knots);

/// The knot vector with each break repeated, degree + 1 times at both ends whatever is stated there.
std::vector<double> clamped_knots(int degree, const Breaks& breaks);
/// Clamped vector with simple interior knots. @pre breaks ascending, at least 2
std::vector<double> clamped_knots(int degree, std::span<const double> breaks);

/// Parameters at which the coefficients of a linear function are its values: means of `degree` consecutive knots.
std::vector<double> greville_abscissae(std::span<const double> knots, int degree);

/// A knot vector with more knots, and the map of coefficients to it. Rows are convex combinations.
struct Refinement {
  std::vector<double> knots;
  Eigen::SparseMatrix<double, Eigen::RowMajor> map;  ///< new coefficients = map * old ones
};
/// Insert knots (repeated values repeat) by Boehm's rule.
/// @pre degree >= 1; each added value inside the domain [knots[degree], knots[n]], no multiplicity over degree + 1
Refinement insert_knots(std::span<const double> knots, int degree, std::span<const double> added);

/// Abort with a clear text unless knots are finite, ascending and clamped for the degree, with interior multiplicities
/// of at most max(degree, 1). @throws std::invalid_argument naming `what`
void require_clamped(std::span<const double> knots, int degree, const char* what);

}  // namespace celadon
