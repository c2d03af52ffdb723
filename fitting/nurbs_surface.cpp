#include "fitting/nurbs_surface.h"

#include <algorithm>
#include <array>

#include "fitting/bspline_basis.h"

namespace celadon {
namespace {

double within(double t, const std::vector<double>& knots) {
  return std::clamp(t, knots.front(), knots.back());
}

}  // namespace

Eigen::Vector3d NurbsSurface::evaluate(double u, double v) const {
  u = within(u, knots_u), v = within(v, knots_v);
  const int span_u = find_span(knots_u, degree_u, u), span_v = find_span(knots_v, degree_v, v);
  const BasisValues Nu = basis_values(knots_u, degree_u, span_u, u), Nv = basis_values(knots_v, degree_v, span_v, v);
  Eigen::Vector4d sum = Eigen::Vector4d::Zero();
  for (int i = 0; i <= degree_u; ++i) {
    Eigen::Vector4d row = Eigen::Vector4d::Zero();
    for (int j = 0; j <= degree_v; ++j) {
      row += Nv[static_cast<std::size_t>(j)] * control_point(span_u - degree_u + i, span_v - degree_v + j);
    }
    sum += Nu[static_cast<std::size_t>(i)] * row;
  }
  return sum.head<3>() / sum.w();
}

SurfaceDerivatives NurbsSurface::derivatives(double u, double v) const {
  u = within(u, knots_u), v = within(v, knots_v);
  const int span_u = find_span(knots_u, degree_u, u), span_v = find_span(knots_v, degree_v, v);
  const auto Nu = basis_derivatives(knots_u, degree_u, span_u, u);
  const auto Nv = basis_derivatives(knots_v, degree_v, span_v, v);
  Eigen::Vector4d H[3][3];  // H[a][b]: a-th derivative in u, b-th in v, of the homogeneous surface
  for (auto& row : H) std::fill(std::begin(row), std::end(row), Eigen::Vector4d::Zero());
  for (int i = 0; i <= degree_u; ++i) {
    std::array<Eigen::Vector4d, 3> row;
    row.fill(Eigen::Vector4d::Zero());
    for (int j = 0; j <= degree_v; ++j) {
      const Eigen::Vector4d c = control_point(span_u - degree_u + i, span_v - degree_v + j);
      for (std::size_t b = 0; b < 3; ++b) row[b] += Nv[b][static_cast<std::size_t>(j)] * c;
    }
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t b = 0; a + b < 3; ++b) H[a][b] += Nu[a][static_cast<std::size_t>(i)] * row[b];
    }
  }
  // Quotient rule: differentiate (w S) = H and solve for the highest derivative of S.
  const double w = H[0][0].w(), w_u = H[1][0].w(), w_v = H[0][1].w();
  SurfaceDerivatives d;
  d.S = H[0][0].head<3>() / w;
  d.S_u = (H[1][0].head<3>() - w_u * d.S) / w;
  d.S_v = (H[0][1].head<3>() - w_v * d.S) / w;
  d.S_uu = (H[2][0].head<3>() - 2 * w_u * d.S_u - H[2][0].w() * d.S) / w;
  d.S_uv = (H[1][1].head<3>() - w_u * d.S_v - w_v * d.S_u - H[1][1].w() * d.S) / w;
  d.S_vv = (H[0][2].head<3>() - 2 * w_v * d.S_v - H[0][2].w() * d.S) / w;
  return d;
}

}  // namespace celadon
