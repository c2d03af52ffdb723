// Every coefficient of a product is the blossom of a product of Bezier segments (A.11) at consecutive knots of the
// product; that is linear in the few coefficients of F on the segment, so each has one short row of weights. Blossoms
// at the final knots also make the removal of knots (A.1, step 4) unnecessary: none is put in that would have to go.
#include "fitting/arc_product.h"

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>

#include "fitting/bspline_basis.h"
#include "fitting/knots.h"

namespace celadon {
namespace {

// Degree 2 product with the arcs: F of degree q with multiplicity m at a knot is C(q-m) there, hence S has m + 2 (A.7);
// at a joint the arcs' own denominator is only C0: q + 2.
std::vector<double> product_knots(const BaseArcs& arcs, int q, std::span<const double> knots_F) {
  Breaks breaks = breaks_of(knots_F);
  for (int j = 1; j < arcs.count(); ++j) {
    if (j <= knots_F.front() || j >= knots_F.back()) continue;
    const auto at = std::lower_bound(breaks.values.begin(), breaks.values.end(), static_cast<double>(j));
    const auto index = at - breaks.values.begin();
    if (*at != j) {
      breaks.values.insert(at, j);
      breaks.multiplicities.insert(breaks.multiplicities.begin() + index, 0);
    }
    breaks.multiplicities[static_cast<std::size_t>(index)] = q;
  }
  for (int& m : breaks.multiplicities) m += 2;
  return clamped_knots(q + 2, breaks);
}

// Bezier coefficients (x w, y w, w) of an arc restricted to [lo, hi].
Eigen::Matrix3d arc_segment(const Eigen::MatrixX3d& control_points, int arc, double lo, double hi) {
  const Eigen::Matrix3d b = control_points.middleRows<3>(2 * static_cast<Eigen::Index>(arc));
  const double s = lo - arc, t = hi - arc;
  Eigen::Matrix3d segment;
  const auto blossom = [&](double e, double f) -> Eigen::RowVector3d {
    return (1 - f) * ((1 - e) * b.row(0) + e * b.row(1)) + f * ((1 - e) * b.row(1) + e * b.row(2));
  };
  segment << blossom(s, s), blossom(s, t), blossom(t, t);
  return segment;
}

std::vector<ArcColumn> product_columns(const BaseArcs& arcs, int q, std::span<const double> knots_F,
                                       const std::vector<double>& knots) {
  const int degree = q + 2;
  const std::vector<double> breaks = breaks_of(knots).values;
  const std::vector<double> nodes = greville_abscissae(knots, degree);
  const Eigen::MatrixX3d arc_points = arcs.control_points();
  std::vector<ArcColumn> columns(nodes.size());

  for (std::size_t j = 0; j < nodes.size(); ++j) {
    // Any segment in the control point's support gives its value; the one around its node without amplification.
    auto above = std::upper_bound(breaks.begin(), breaks.end() - 1, nodes[j]);
    const double lo = *(above - 1), hi = *above, middle = 0.5 * (lo + hi);
    const int span = find_span(knots_F, q, middle);
    const IntervalMatrix bezier = bezier_conversion(knots_F, q, span, lo, hi);
    const Eigen::Matrix3d arc = arc_segment(arc_points, std::min(static_cast<int>(middle), arcs.count() - 1), lo, hi);

    // Blossom at the knots j+1 ... j+degree: weights of the Bezier coefficients are those of prod (1 - s_i + s_i t).
    std::array<double, kMaxDegree + 1> blossom{1};
    for (int i = 1; i <= degree; ++i) {
      const double s = (knots[j + static_cast<std::size_t>(i)] - lo) / (hi - lo);
      for (int k = i; k >= 0; --k) {
        const auto K = static_cast<std::size_t>(k);
        blossom[K] = (1 - s) * blossom[K] + (k > 0 ? s * blossom[K - 1] : 0);
      }
    }
    ArcColumn& column = columns[j];
    column.first = span - q;
    for (int l = 0; l <= q; ++l) {
      Eigen::RowVector3d weight = Eigen::RowVector3d::Zero();  // of Bezier coefficient l of F in (A.11)
      for (int e = 0; e <= 2; ++e) {
        const double share = binomial(q, l) * binomial(2, e) / binomial(degree, l + e);
        weight += blossom[static_cast<std::size_t>(l + e)] * share * arc.row(e);
      }
      for (int a = 0; a <= q; ++a) {
        column.x[static_cast<std::size_t>(a)] += weight.x() * bezier(l, a);
        column.y[static_cast<std::size_t>(a)] += weight.y() * bezier(l, a);
        column.wf[static_cast<std::size_t>(a)] += weight.z() * bezier(l, a);
      }
      column.w += weight.z();
    }
  }
  return columns;
}

}  // namespace

ArcProduct::ArcProduct(const BaseArcs& arcs, int degree, std::span<const double> knots_F)
    : knots(product_knots(arcs, degree, knots_F)), columns(product_columns(arcs, degree, knots_F, knots)) {}

}  // namespace celadon
