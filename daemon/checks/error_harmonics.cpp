#include "daemon/checks/error_harmonics.h"

#include <algorithm>
#include <cmath>
#include <numbers>

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
  std::vector<double> around;
  std::vector<std::size_t> gaps;
  for (int j = 0; j < ErrorMap::kAround; ++j) {
    double sum = 0;
    int n = 0;
    for (int i = 0; i < ErrorMap::kAlong; ++i)
      if (const auto mean = map.mean_mm(i, j)) sum += *mean, ++n;
    if (n == 0) gaps.push_back(around.size());
    around.push_back(n == 0 ? 0 : sum / n);
  }
  if (10 * gaps.size() > around.size()) return std::nullopt;
  // A gap is what its neighbours say.
  const std::size_t n = around.size();
  for (const std::size_t gap : gaps) {
    const auto beside = [&](std::size_t step) {
      std::size_t at = gap;
      do at = (at + step) % n;
      while (std::binary_search(gaps.begin(), gaps.end(), at));
      return around[at];
    };
    around[gap] = 0.5 * (beside(1) + beside(n - 1));
  }
  return around;
}

std::array<double, 2> first_harmonics(const std::vector<double>& around) {
  const Harmonic h1 = harmonic(around, 1), h2 = harmonic(around, 2);
  return {std::hypot(h1.c, h1.s), std::hypot(h2.c, h2.s)};
}

double rms_beyond_harmonics(const std::vector<double>& around) {
  const auto n = static_cast<double>(around.size());
  double mean = 0, square = 0;
  for (const double e : around) mean += e / n;
  for (const double e : around) square += (e - mean) * (e - mean);
  // By Parseval.
  for (const double a : first_harmonics(around)) square -= n / 2 * a * a;
  return std::sqrt(std::max(0., square) / n);
}

}  // namespace celadon
