// The symbolic product: homogeneous control points of S = F . B, thesis (3.8), (B.3).
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>

#include "fitting/arc_product.h"
#include "fitting/common_knots.h"
#include "fitting/knots.h"
#include "fitting/nurbs_surface.h"
#include "fitting/range_function.h"

namespace celadon {
namespace {

using Matrix = Eigen::MatrixXd;

// Rows of F combined along u, columns along v, as an arc product's columns say.
Matrix along_u(const ArcProduct& product, int degree, std::array<double, 6> ArcColumn::*of, const Matrix& f) {
  Matrix result = Matrix::Zero(static_cast<Eigen::Index>(product.columns.size()), f.cols());
  for (Eigen::Index i = 0; i < result.rows(); ++i) {
    const ArcColumn& column = product.columns[static_cast<std::size_t>(i)];
    for (int a = 0; a <= degree; ++a)
      result.row(i) += (column.*of)[static_cast<std::size_t>(a)] * f.row(column.first + a);
  }
  return result;
}
Matrix along_v(const ArcProduct& product, int degree, std::array<double, 6> ArcColumn::*of, bool closed,
               const Matrix& f) {
  Matrix result = Matrix::Zero(f.rows(), static_cast<Eigen::Index>(product.columns.size()));
  for (Eigen::Index j = 0; j < result.cols(); ++j) {
    const ArcColumn& column = product.columns[closed && j + 1 == result.cols() ? 0 : static_cast<std::size_t>(j)];
    for (int a = 0; a <= degree; ++a)
      result.col(j) += (column.*of)[static_cast<std::size_t>(a)] * f.col(column.first + a);
  }
  return result;
}

Eigen::VectorXd weights(const ArcProduct& product) {
  Eigen::VectorXd w(static_cast<Eigen::Index>(product.columns.size()));
  for (Eigen::Index k = 0; k < w.size(); ++k) w[k] = product.columns[static_cast<std::size_t>(k)].w;
  return w;
}

}  // namespace

NurbsSurface symbolic_product(const RangeFunction& range) {
  const BaseSurface& base = range.base();
  Matrix f = range.coefficients();
  if (f.size() == 0) throw std::invalid_argument("symbolic_product: an empty range function");
  const bool closed = base.arcs.closed();
  if (closed && (f.col(0) - f.col(f.cols() - 1)).cwiseAbs().maxCoeff() > 1e-9 * f.cwiseAbs().maxCoeff()) {
    throw std::invalid_argument("symbolic_product: F is not closed, F(0) differs from F(" +
                                std::to_string(base.arcs.count()) + ")");
  }
  const int p = range.degree_u();
  int q = range.degree_v();
  std::vector<double> knots_v = range.knots_v();
  Matrix rims;  // the heights of both, coefficients around
  if (base.heights) {
    const RangeFunction heights = base.heights->clipped(base.band_start, base.band_end);
    SplineRows z{heights.degree_v(), heights.knots_v(), heights.coefficients()}, r{q, std::move(knots_v), std::move(f)};
    share_knots(r, z);
    q = r.degree;
    knots_v = r.knots;
    f = std::move(r.coefficients);
    rims = std::move(z.coefficients);
  }
  const ArcProduct around(base.arcs, q, knots_v);
  NurbsSurface surface;
  surface.degree_v = q + 2;
  surface.knots_v = around.knots;
  surface.closed_v = closed;
  Eigen::VectorXd w_v = weights(around);
  if (closed) w_v[w_v.size() - 1] = w_v[0];

  Matrix X, Y, Z, W;
  if (base.spherical()) {
    // (F sin phi cos theta, F sin phi sin theta, F cos phi), the meridian's arcs being (cos, sin) of phi.
    const ArcProduct meridian(BaseSurface::meridian(), p, range.knots_u());
    surface.degree_u = p + 2;
    surface.knots_u = meridian.knots;
    const Matrix off_axis = along_u(meridian, p, &ArcColumn::y, f);
    X = along_v(around, q, &ArcColumn::x, closed, off_axis);
    Y = along_v(around, q, &ArcColumn::y, closed, off_axis);
    Z = along_v(around, q, &ArcColumn::wf, closed, along_u(meridian, p, &ArcColumn::x, f));
    W = weights(meridian) * w_v.transpose();
  } else {
    surface.degree_u = std::max(p, 1);
    surface.knots_u = p == 0 ? std::vector<double>{0, 0, 1, 1} : range.knots_u();
    const int rows = surface.count_u();
    const Matrix all = p == 0 ? f.replicate(2, 1).eval() : f;
    X = along_v(around, q, &ArcColumn::x, closed, all);
    Y = along_v(around, q, &ArcColumn::y, closed, all);
    // Z is linear in u (B.3): its coefficients in any degree are its values at the nodes.
    const std::vector<double> nodes = greville_abscissae(surface.knots_u, surface.degree_u);
    const Eigen::Map<const Eigen::ArrayXd> u(nodes.data(), rows);
    if (base.heights) {
      Z = along_v(around, q, &ArcColumn::wf, closed, (1 - u).matrix() * rims.row(0) + u.matrix() * rims.row(1));
    } else {
      Z = ((1 - u) * base.band_start + u * base.band_end).matrix() * w_v.transpose();
    }
    W = Eigen::VectorXd::Ones(rows) * w_v.transpose();
  }

  const Eigen::Matrix3d R = base.X_WB.linear();
  const Eigen::Vector3d t = base.X_WB.translation();
  surface.control_points.resize(4, X.size());
  for (Eigen::Index i = 0; i < X.rows(); ++i)
    for (Eigen::Index j = 0; j < X.cols(); ++j) {
      const Eigen::Vector3d p_W = R * Eigen::Vector3d(X(i, j), Y(i, j), Z(i, j)) + W(i, j) * t;
      surface.control_points.col(i * X.cols() + j) << p_W, W(i, j);
    }
  return surface;
}

}  // namespace celadon
