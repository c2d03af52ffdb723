#pragma once
// Gauss - Legendre quadrature of any order on [-1, 1].

#include <vector>

namespace celadon {

/// Nodes ascending, symmetric; weights of the same length. Exact for polynomials of degree 2 n - 1.
struct GaussRule {
  std::vector<double> nodes, weights;
};

/// The rule of n points, made once. @pre 1 <= n <= 32
const GaussRule& gauss_rule(int n);

}  // namespace celadon
