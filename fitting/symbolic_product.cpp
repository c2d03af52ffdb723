// The symbolic product as one linear map in v. Every control point of S^w = (F X^w, F Y^w, Z^w, W) (B.3) is the blossom
// of a product of Bezier segments (A.11) at consecutive knots of S; that is linear in the few coefficients of F on the
// segment, so X and Y have one short row of weights per column of control points, the same for all of u. Blossoms at
// the final knots also make the removal of knots (A.1, step 4) unnecessary: none is put in that would have to go.
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>

#include "fitting/bspline_basis.h"
#include "fitting/knots.h"
#include "fitting/nurbs_surface.h"
#include "fitting/range_function.h"

namespace celadon {
namespace {

// Degree 2 product with the arcs: F of degree q with multiplicity m at a knot is C(q-m) there, hence S has m + 2 (A.7);
// at a joint the arcs' own denominator is only C0: q + 2.
std::vector<double> product_knots(const RangeFunction& range) {
  const int q = range.degree_v(), arcs = range.base().arcs.count();
  Breaks breaks = breaks_of(range.knots_v());
  for (int j = 1; j < arcs; ++j) {
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

// One column of control points: X^w F = sum of x[a] f[first + a], Y^w F likewise, and W.
struct Column {
  int first = 0;
  std::array<double, 6> x{}, y{};
  double w = 0;
};

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

std::vector<Column> product_columns(const RangeFunction& range, const std::vector<double>& knots) {
  const int q = range.degree_v(), degree = q + 2, arcs = range.base().arcs.count();
  const std::vector<double>& knots_F = range.knots_v();
  const std::vector<double> breaks = breaks_of(knots).values;
  const std::vector<double> nodes = greville_abscissae(knots, degree);
  const Eigen::MatrixX3d arc_points = range.base().arcs.control_points();
  std::vector<Column> columns(nodes.size());

  for (std::size_t j = 0; j < nodes.size(); ++j) {
    // Any segment in the control point's support gives its value; the one around its node without amplification.
    auto above = std::upper_bound(breaks.begin(), breaks.end() - 1, nodes[j]);
    const double lo = *(above - 1), hi = *above, middle = 0.5 * (lo + hi);
    const int span = find_span(knots_F, q, middle);
    const IntervalMatrix bezier = bezier_conversion(knots_F, q, span, lo, hi);
    const Eigen::Matrix3d arc = arc_segment(arc_points, std::min(static_cast<int>(middle), arcs - 1), lo, hi);

    // Blossom at the knots j+1 ... j+degree: weights of the Bezier coefficients are those of prod (1 - s_i + s_i t).
    std::array<double, kMaxDegree + 1> blossom{1};
    for (int i = 1; i <= degree; ++i) {
      const double s = (knots[j + static_cast<std::size_t>(i)] - lo) / (hi - lo);
      for (int k = i; k >= 0; --k) {
        const auto K = static_cast<std::size_t>(k);
        blossom[K] = (1 - s) * blossom[K] + (k > 0 ? s * blossom[K - 1] : 0);
      }
    }
    Column& column = columns[j];
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
      }
      column.w += weight.z();
    }
  }
  return columns;
}

}  // namespace

NurbsSurface symbolic_product(const RangeFunction& range) {
  const BaseCylinder& base = range.base();
  const Eigen::MatrixXd& f = range.coefficients();
  if (f.size() == 0) throw std::invalid_argument("symbolic_product: an empty range function");
  const bool closed = base.arcs.closed();
  if (closed && (f.col(0) - f.col(f.cols() - 1)).cwiseAbs().maxCoeff() > 1e-9 * f.cwiseAbs().maxCoeff()) {
    throw std::invalid_argument("symbolic_product: F is not closed, F(0) differs from F(" +
                                std::to_string(base.arcs.count()) + ")");
  }
  NurbsSurface surface;
  surface.degree_u = std::max(range.degree_u(), 1);
  surface.degree_v = range.degree_v() + 2;
  surface.knots_u = range.degree_u() == 0 ? std::vector<double>{0, 0, 1, 1} : range.knots_u();
  surface.knots_v = product_knots(range);
  surface.closed_v = closed;
  const int rows = surface.count_u(), count = surface.count_v();

  // Z is linear in u (B.3): its coefficients in any degree are its values at the nodes.
  Eigen::ArrayXd z =
      Eigen::Map<const Eigen::ArrayXd>(greville_abscissae(surface.knots_u, surface.degree_u).data(), rows);
  z = (1 - z) * base.z_start_mm + z * base.z_end_mm;

  const std::vector<Column> columns = product_columns(range, surface.knots_v);
  const Eigen::Matrix3d R = base.X_WB.linear();
  const Eigen::Vector3d t = base.X_WB.translation();
  surface.control_points.resize(4, static_cast<Eigen::Index>(rows) * count);
  Eigen::ArrayXd x(f.rows()), y(f.rows());
  for (int j = 0; j < count; ++j) {
    const Column& column = columns[closed && j + 1 == count ? 0 : static_cast<std::size_t>(j)];
    x.setZero();
    y.setZero();
    for (int a = 0; a <= range.degree_v(); ++a) {
      x += column.x[static_cast<std::size_t>(a)] * f.col(column.first + a).array();
      y += column.y[static_cast<std::size_t>(a)] * f.col(column.first + a).array();
    }
    for (int i = 0; i < rows; ++i) {
      const Eigen::Index source = std::min<Eigen::Index>(i, f.rows() - 1);  // degree 0: both rims are alike
      const Eigen::Vector3d p = R * Eigen::Vector3d(x[source], y[source], column.w * z[i]) + column.w * t;
      surface.control_points.col(static_cast<Eigen::Index>(i) * count + j) << p, column.w;
    }
  }
  return surface;
}

}  // namespace celadon
