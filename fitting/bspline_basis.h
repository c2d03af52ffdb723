#pragma once
// B-spline basis functions of small degree on any knot vector, and each interval's conversion to Bezier coefficients.
// Source: Cox - de Boor recurrence; blossoms. README.md, "Knots".

#include <Eigen/Core>
#include <array>
#include <span>

namespace celadon {

/// Largest degree: the product of a quintic with the quadratic arcs.
inline constexpr int kMaxDegree = 7;

/// Values for the degree + 1 functions on one knot interval.
using BasisValues = std::array<double, kMaxDegree + 1>;
/// Small square matrix of a knot interval, no heap.
using IntervalMatrix =
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMaxDegree + 1, kMaxDegree + 1>;

/// Index s of the non-empty interval [knots[s], knots[s+1]) that holds t; t outside the domain goes to its first or
/// last interval, the domain's end to the last one. Functions s - degree ... s do not vanish there.
int find_span(std::span<const double> knots, int degree, double t);

/// The degree + 1 functions that do not vanish on the span, at t (any t: the interval's polynomials).
BasisValues basis_values(std::span<const double> knots, int degree, int span, double t);
/// Their derivatives of order 0, 1, 2.
std::array<BasisValues, 3> basis_derivatives(std::span<const double> knots, int degree, int span, double t);

/// Bezier coefficients on [lo, hi] of the span's polynomials = matrix * B-spline coefficients span - degree ... span.
/// For [lo, hi] within the span's interval entries are in [0, 1]; rows sum to 1.
IntervalMatrix bezier_conversion(std::span<const double> knots, int degree, int span, double lo, double hi);
/// The same on the whole interval [knots[span], knots[span + 1]].
IntervalMatrix bezier_conversion(std::span<const double> knots, int degree, int span);

/// Power coefficients in s = 2x - 1 in [-1, 1], constant first = matrix * Bezier coefficients over x in [0, 1]. Exact.
const IntervalMatrix& power_from_bezier(int degree);

/// Binomial coefficient. @pre 0 <= k <= n <= kMaxDegree
double binomial(int n, int k);

}  // namespace celadon
