#include "fitting/knots.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

namespace celadon {

Breaks breaks_of(std::span<const double> knots) {
  Breaks breaks;
  for (const double t : knots) {
    if (breaks.values.empty() || t != breaks.values.back()) {
      breaks.values.push_back(t);
      breaks.multiplicities.push_back(0);
    }
    ++breaks.multiplicities.back();
  }
  return breaks;
}

std::vector<double> clamped_knots(int degree, const Breaks& breaks) {
  std::vector<double> knots;
  for (std::size_t k = 0; k < breaks.values.size(); ++k) {
    const bool end = k == 0 || k + 1 == breaks.values.size();
    knots.insert(knots.end(), static_cast<std::size_t>(end ? degree + 1 : breaks.multiplicities[k]), breaks.values[k]);
  }
  return knots;
}

std::vector<double> clamped_knots(int degree, std::span<const double> breaks) {
  return clamped_knots(degree, Breaks{{breaks.begin(), breaks.end()}, std::vector<int>(breaks.size(), 1)});
}

std::vector<double> greville_abscissae(std::span<const double> knots, int degree) {
  if (degree < 1) throw std::invalid_argument("greville_abscissae: degree " + std::to_string(degree) + " is below 1");
  std::vector<double> nodes(knots.size() - static_cast<std::size_t>(degree) - 1);
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    double sum = 0;
    for (int k = 1; k <= degree; ++k) sum += knots[i + static_cast<std::size_t>(k)];
    // The mean of equal knots is the knot itself, without the rounding of the sum.
    nodes[i] = knots[i + 1] == knots[i + static_cast<std::size_t>(degree)] ? knots[i + 1] : sum / degree;
  }
  return nodes;
}

namespace {

// One row of the map: old coefficient and weight, ascending.
using Row = std::vector<std::pair<int, double>>;

Row blend(const Row& a, double weight_a, const Row& b, double weight_b) {
  Row sum;
  sum.reserve(a.size() + 1);
  std::size_t i = 0, j = 0;
  while (i < a.size() || j < b.size()) {
    if (j == b.size() || (i < a.size() && a[i].first < b[j].first)) {
      sum.emplace_back(a[i].first, weight_a * a[i].second);
      ++i;
    } else if (i == a.size() || b[j].first < a[i].first) {
      sum.emplace_back(b[j].first, weight_b * b[j].second);
      ++j;
    } else {
      sum.emplace_back(a[i].first, weight_a * a[i].second + weight_b * b[j].second);
      ++i, ++j;
    }
  }
  std::erase_if(sum, [](const auto& entry) { return entry.second == 0; });
  return sum;
}

void insert(std::vector<double>& knots, int degree, double t, std::vector<Row>& rows) {
  const auto above = std::upper_bound(knots.begin(), knots.end(), t);
  const std::ptrdiff_t span = above - knots.begin() - 1;
  const std::ptrdiff_t equal = above - std::lower_bound(knots.begin(), knots.end(), t);
  const auto knot = [&](std::ptrdiff_t i) { return knots[static_cast<std::size_t>(i)]; };
  const auto row = [&](std::ptrdiff_t i) -> const Row& { return rows[static_cast<std::size_t>(i)]; };
  std::vector<Row> blended;  // new rows span - degree + 1 ... span - equal
  for (std::ptrdiff_t i = span - degree + 1; i <= span - equal; ++i) {
    const double alpha = (t - knot(i)) / (knot(i + degree) - knot(i));
    blended.push_back(blend(row(i - 1), 1 - alpha, row(i), alpha));
  }
  // Row span - equal is followed by its old self; blended rows overwrite the others.
  const std::ptrdiff_t keep = std::max<std::ptrdiff_t>(span - equal, span - degree);
  rows.insert(rows.begin() + keep + 1, row(keep));
  std::ptrdiff_t i = span - degree + 1;
  for (Row& b : blended) rows[static_cast<std::size_t>(i++)] = std::move(b);
  knots.insert(above, t);
}

}  // namespace

Refinement insert_knots(std::span<const double> knots, int degree, std::span<const double> added) {
  const auto n = knots.size() - static_cast<std::size_t>(degree) - 1;
  std::vector<Row> rows(n);
  for (std::size_t i = 0; i < n; ++i) rows[i] = {{static_cast<int>(i), 1.0}};
  Refinement refined{{knots.begin(), knots.end()}, {}};
  for (const double t : added) {
    if (!(t >= knots[static_cast<std::size_t>(degree)] && t <= knots[n])) {
      throw std::invalid_argument("insert_knots: " + std::to_string(t) + " is outside the domain");
    }
    insert(refined.knots, degree, t, rows);
  }
  refined.map.resize(static_cast<Eigen::Index>(rows.size()), static_cast<Eigen::Index>(n));
  std::vector<Eigen::Triplet<double>> entries;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    for (const auto& [column, weight] : rows[i]) entries.emplace_back(static_cast<int>(i), column, weight);
  }
  refined.map.setFromTriplets(entries.begin(), entries.end());
  return refined;
}

void require_clamped(std::span<const double> knots, int degree, const char* what) {
  const auto refuse = [what](const std::string& why) {
    throw std::invalid_argument(std::string(what) + ": the knot vector " + why);
  };
  const auto order = static_cast<std::size_t>(degree) + 1;
  if (degree < 0 || knots.size() < 2 * order) {
    refuse("has " + std::to_string(knots.size()) + " knots, too few for degree " + std::to_string(degree));
  }
  for (std::size_t i = 0; i < knots.size(); ++i) {
    if (!std::isfinite(knots[i]) || (i > 0 && knots[i] < knots[i - 1])) {
      refuse("is not finite and ascending at index " + std::to_string(i));
    }
  }
  const Breaks breaks = breaks_of(knots);
  const std::size_t last = breaks.values.size() - 1;
  if (last == 0) refuse("has no interval");
  for (std::size_t k = 0; k <= last; ++k) {
    const int m = breaks.multiplicities[k];
    const bool end = k == 0 || k == last;
    if (end ? m != degree + 1 : m > std::max(degree, 1)) {
      refuse("has multiplicity " + std::to_string(m) + " at " + std::to_string(breaks.values[k]) +
             (end ? ", an end" : ""));
    }
  }
}

}  // namespace celadon
