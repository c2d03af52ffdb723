#include "fitting/common_knots.h"

#include <algorithm>
#include <stdexcept>
#include <string>

#include "fitting/knots.h"

namespace celadon {
namespace {

void insert_missing(SplineRows& f, const std::vector<double>& others) {
  const Breaks own = breaks_of(f.knots), other = breaks_of(others);
  std::vector<double> added;
  for (std::size_t k = 0; k < other.values.size(); ++k) {
    const auto at = std::lower_bound(own.values.begin(), own.values.end(), other.values[k]);
    const bool there = at != own.values.end() && *at == other.values[k];
    const int has = there ? own.multiplicities[static_cast<std::size_t>(at - own.values.begin())] : 0;
    added.insert(added.end(), static_cast<std::size_t>(std::max(other.multiplicities[k] - has, 0)), other.values[k]);
  }
  if (added.empty()) return;
  const Refinement finer = insert_knots(f.knots, f.degree, added);
  f.knots = finer.knots;
  f.coefficients = (f.coefficients * finer.map.transpose()).eval();
}

void raise_constant(SplineRows& f, const SplineRows& like) {
  const auto count = static_cast<Eigen::Index>(like.knots.size()) - like.degree - 1;
  f = {like.degree, like.knots, f.coefficients.col(0).replicate(1, count).eval()};
}

}  // namespace

void share_knots(SplineRows& a, SplineRows& b) {
  if (a.degree == 0 && b.degree == 0) return;
  if (a.degree == 0) return raise_constant(a, b);
  if (b.degree == 0) return raise_constant(b, a);
  if (a.degree != b.degree)
    throw std::invalid_argument("share_knots: the degrees " + std::to_string(a.degree) + " and " +
                                std::to_string(b.degree) + " differ");
  insert_missing(a, b.knots);
  insert_missing(b, a.knots);
}

}  // namespace celadon
