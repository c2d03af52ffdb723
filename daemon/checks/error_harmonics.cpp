#include "daemon/checks/error_harmonics.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

namespace celadon {
namespace {

struct Harmonic {
  double c = 0, s = 0;
};
Harmonic harmonic(const std::vector<double>& around, int k) {
  Harmonic h;
  const auto n = static_cast<double>(around.size());
  for (std::size_t j = 0; j < around.size(); ++j) {
    const double angle = 2 * std::numbers::pi * k * (static_cast<double>(j) + 0.5) / n;
    h.c += 2 / n * around[j] * std::cos(angle);
    h.s += 2 / n * around[j] * std::sin(angle);
  }
  return h;
}

}  // namespace

std::optional<std::vector<double>> errors_around(const ErrorMap& map) {
  if (map.empty()) return std::nullopt;
  std::vector<std::optional<double>> fields;
  for (int j = 0; j < ErrorMap::kAround; ++j) {
    double sum = 0;
    int n = 0;
    for (int i = 0; i < ErrorMap::kAlong; ++i)
      if (const auto mean = map.mean_mm(i, j)) sum += *mean, ++n;
    fields.push_back(n == 0 ? std::nullopt : std::optional(sum / n));
  }
  return closed_around(fields);
}

std::optional<std::vector<double>> closed_around(const std::vector<std::optional<double>>& fields) {
  const std::size_t n = fields.size();
  const auto gaps = static_cast<std::size_t>(std::count(fields.begin(), fields.end(), std::nullopt));
  if (10 * gaps > n) return std::nullopt;
  std::vector<double> around;
  for (std::size_t at = 0; at < n; ++at) {
    const auto beside = [&](std::size_t step) {
      std::size_t k = at;
      while (!fields[k]) k = (k + step) % n;
      return *fields[k];
    };
    around.push_back(0.5 * (beside(1) + beside(n - 1)));
  }
  return around;
}

std::array<double, 2> first_harmonics(const std::vector<double>& around) {
  const Harmonic h1 = harmonic(around, 1), h2 = harmonic(around, 2);
  return {std::hypot(h1.c, h1.s), std::hypot(h2.c, h2.s)};
}

std::vector<double> beyond_harmonics(const std::vector<double>& around) {
  const auto n = static_cast<double>(around.size());
  const double mean = std::accumulate(around.begin(), around.end(), 0.) / n;
  const Harmonic first = harmonic(around, 1), second = harmonic(around, 2);
  std::vector<double> left;
  for (std::size_t j = 0; j < around.size(); ++j) {
    const double angle = 2 * std::numbers::pi * (static_cast<double>(j) + 0.5) / n;
    left.push_back(around[j] - mean - first.c * std::cos(angle) - first.s * std::sin(angle) -
                   second.c * std::cos(2 * angle) - second.s * std::sin(2 * angle));
  }
  return left;
}

}  // namespace celadon
