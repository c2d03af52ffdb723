#include "fitting/gauss_legendre.h"

#include <array>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>

namespace celadon {
namespace {

constexpr int kMost = 32;

// The roots of P_n by Newton's iteration from Chebyshev's guess, in extended precision; weights 2/((1 - x^2) P_n'^2).
GaussRule make_rule(int n) {
  GaussRule rule{std::vector<double>(static_cast<std::size_t>(n)), std::vector<double>(static_cast<std::size_t>(n))};
  for (int k = 0; k < (n + 1) / 2; ++k) {
    long double x = std::cos(std::numbers::pi_v<long double> * (k + 0.75L) / (n + 0.5L)), slope = 1;
    for (int step = 0; step < 8; ++step) {
      long double below = 1, value = x;  // P_0, P_1
      for (int i = 2; i <= n; ++i) {
        const long double next = ((2 * i - 1) * x * value - (i - 1) * below) / i;
        below = value;
        value = next;
      }
      slope = n * (x * value - below) / (x * x - 1);
      x -= value / slope;
    }
    if (2 * k + 1 == n) x = 0;
    const auto weight = static_cast<double>(2 / ((1 - x * x) * slope * slope));
    const auto low = static_cast<std::size_t>(k), high = static_cast<std::size_t>(n - 1 - k);
    rule.nodes[low] = static_cast<double>(-x);
    rule.nodes[high] = static_cast<double>(x);
    rule.weights[low] = rule.weights[high] = weight;
  }
  return rule;
}

}  // namespace

const GaussRule& gauss_rule(int n) {
  static const auto rules = [] {
    std::array<GaussRule, kMost + 1> all;
    for (int k = 1; k <= kMost; ++k) all[static_cast<std::size_t>(k)] = make_rule(k);
    return all;
  }();
  if (n < 1 || n > kMost) throw std::invalid_argument("gauss_rule: " + std::to_string(n) + " points");
  return rules[static_cast<std::size_t>(n)];
}

}  // namespace celadon
