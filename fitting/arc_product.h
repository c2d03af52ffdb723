#pragma once
// Products of splines with the base arcs, in one direction. Source: thesis (A.4) - (A.11); README.md, "Symbolic
// product".

#include <array>
#include <span>
#include <vector>

#include "fitting/base_arcs.h"

namespace celadon {

/// One coefficient of the products of a spline F with the arcs' homogeneous components: X F = sum of x[a] f[first + a]
/// for the coefficients f of F, Y F and W F likewise, and W alone.
struct ArcColumn {
  int first = 0;
  std::array<double, 6> x{}, y{}, wf{};
  double w = 0;
};

/// Splines of degree q over some of the arcs' parameters, times the arcs: of degree q + 2, none of whose knots could be
/// removed for all F.
struct ArcProduct {
  std::vector<double> knots;       ///< clamped
  std::vector<ArcColumn> columns;  ///< one a coefficient
  /// @pre knots clamped for the degree 0..5, their ends within [0, arcs.count()]
  ArcProduct(const BaseArcs& arcs, int degree, std::span<const double> knots_F);
};

}  // namespace celadon
