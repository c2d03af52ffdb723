#include "fitting/bspline_basis.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace celadon {

int find_span(std::span<const double> knots, int degree, double t) {
  const auto first = knots.begin() + degree;
  const auto last = knots.end() - degree - 1;  // end of the domain
  auto above = std::upper_bound(first, last, t);
  if (above == last) above = std::lower_bound(first, last, *last);  // last non-empty interval
  if (above == first) above = std::upper_bound(first, last, *first);
  return static_cast<int>(above - knots.begin()) - 1;
}

BasisValues basis_values(std::span<const double> knots, int degree, int span, double t) {
  BasisValues N{};
  N[0] = 1;
  for (int d = 1; d <= degree; ++d) {
    double carried = 0;
    for (int r = 0; r < d; ++r) {
      const double lo = knots[static_cast<std::size_t>(span + 1 - d + r)];
      const double hi = knots[static_cast<std::size_t>(span + 1 + r)];
      const double part = N[static_cast<std::size_t>(r)] / (hi - lo);
      N[static_cast<std::size_t>(r)] = carried + (hi - t) * part;
      carried = (t - lo) * part;
    }
    N[static_cast<std::size_t>(d)] = carried;
  }
  return N;
}

std::array<BasisValues, 3> basis_derivatives(std::span<const double> knots, int degree, int span, double t) {
  std::array<BasisValues, 3> D{};
  D[0] = basis_values(knots, degree, span, t);
  for (int order = 1; order <= std::min(2, degree); ++order) {
    BasisValues N = basis_values(knots, degree - order, span, t);
    for (int d = degree - order + 1; d <= degree; ++d) {  // N' of degree d from N of degree d - 1
      double carried = 0;
      for (int r = 0; r < d; ++r) {
        const double lo = knots[static_cast<std::size_t>(span + 1 - d + r)];
        const double hi = knots[static_cast<std::size_t>(span + 1 + r)];
        const double part = d * N[static_cast<std::size_t>(r)] / (hi - lo);
        N[static_cast<std::size_t>(r)] = carried - part;
        carried = part;
      }
      N[static_cast<std::size_t>(d)] = carried;
    }
    D[static_cast<std::size_t>(order)] = N;
  }
  return D;
}

IntervalMatrix bezier_conversion(std::span<const double> knots, int degree, int span) {
  const auto s = static_cast<std::size_t>(span);
  return bezier_conversion(knots, degree, span, knots[s], knots[s + 1]);
}

IntervalMatrix bezier_conversion(std::span<const double> knots, int degree, int span, double lo, double hi) {
  IntervalMatrix bezier(degree + 1, degree + 1);
  for (int k = 0; k <= degree; ++k) {
    // Blossom at (lo ... lo, hi ... hi), hi k times: de Boor's triangle on unit coefficients.
    IntervalMatrix level = IntervalMatrix::Identity(degree + 1, degree + 1);
    for (int d = 1; d <= degree; ++d) {
      const double argument = d <= k ? hi : lo;
      for (int i = degree; i >= d; --i) {
        const double left = knots[static_cast<std::size_t>(span - degree + i)];
        const double right = knots[static_cast<std::size_t>(span + 1 + i - d)];
        const double alpha = (argument - left) / (right - left);
        level.row(i) = (1 - alpha) * level.row(i - 1) + alpha * level.row(i);
      }
    }
    bezier.row(k) = level.row(degree);
  }
  return bezier;
}

const IntervalMatrix& power_from_bezier(int degree) {
  static const auto tables = [] {
    std::array<IntervalMatrix, kMaxDegree + 1> all;
    for (int q = 0; q <= kMaxDegree; ++q) {
      IntervalMatrix& T = all[static_cast<std::size_t>(q)];
      T.setZero(q + 1, q + 1);
      for (int k = 0; k <= q; ++k) {  // binomial(q, k) ((1+s)/2)^k ((1-s)/2)^(q-k)
        for (int a = 0; a <= k; ++a) {
          for (int b = 0; b <= q - k; ++b) {
            T(a + b, k) += std::ldexp(binomial(q, k) * binomial(k, a) * binomial(q - k, b) * (b % 2 ? -1 : 1), -q);
          }
        }
      }
    }
    return all;
  }();
  return tables.at(static_cast<std::size_t>(degree));
}

double binomial(int n, int k) {
  double value = 1;
  for (int i = 1; i <= k; ++i) value = value * (n - k + i) / i;
  return value;
}

}  // namespace celadon
