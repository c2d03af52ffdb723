#pragma once
// Gauss - Legendre quadrature of any order on [-1, 1].

#include <cmath>
#include <cstddef>
#include <vector>

namespace celadon {

/// Nodes ascending, symmetric; weights of the same length. Exact for polynomials of degree 2 n - 1.
struct GaussRule {
  std::vector<double> nodes, weights;
};

/// The rule of n points, made once. @pre 1 <= n <= 32
const GaussRule& gauss_rule(int n);

/// Integral of f over [lo, hi]: halved, six times at most, until rules of n and n + 2 points differ by rounding only.
/// What they differ by is added to error. @pre 1 <= n <= 30
template <class Function>
double integrate(const Function& f, double lo, double hi, int n, double& error, int halvings = 6) {
  const auto by_rule = [&](const GaussRule& rule) {
    double sum = 0;
    for (std::size_t k = 0; k < rule.nodes.size(); ++k) {
      sum += rule.weights[k] * f(lo + 0.5 * (hi - lo) * (1 + rule.nodes[k]));
    }
    return 0.5 * (hi - lo) * sum;
  };
  const double coarse = by_rule(gauss_rule(n)), fine = by_rule(gauss_rule(n + 2)), apart = std::abs(fine - coarse);
  if (halvings > 0 && apart > 2e-15 * std::abs(fine)) {
    const double middle = 0.5 * (lo + hi);
    const double low = integrate(f, lo, middle, n, error, halvings - 1);
    return low + integrate(f, middle, hi, n, error, halvings - 1);
  }
  error += apart;
  return fine;
}

}  // namespace celadon
