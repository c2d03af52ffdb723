#include "fitting/section.h"

#include <cmath>
#include <stdexcept>
#include <string>

#include "fitting/bspline_basis.h"
#include "fitting/gauss_legendre.h"
#include "fitting/nurbs_surface.h"

namespace celadon {
namespace {

// The function's row at a height, as one that is constant along z from there on.
RangeFunction row_at(const RangeFunction& range, double z_mm) {
  BaseSurface base = range.base();
  const double u = (z_mm - base.band_start) / (base.band_end - base.band_start);
  const int p = range.degree_u(), span = find_span(range.knots_u(), p, u);
  const BasisValues N = basis_values(range.knots_u(), p, span, u);
  const Eigen::RowVectorXd row =
      Eigen::Map<const Eigen::RowVectorXd>(N.data(), p + 1) * range.coefficients().middleRows(span - p, p + 1);
  base.band_start = z_mm;
  base.band_end = z_mm + 1;
  return {base, 0, range.degree_v(), {0, 1}, range.knots_v(), row};
}

// Exact for the cube of F; the arcs' denominators are analytic within 2.4 intervals of an arc's middle, so that each
// point more divides what is left of them by 25.
int points_across(int degree) {
  return (3 * degree + 1) / 2 + 14;
}

// Value and slope in t of a Bezier polynomial over [0, 1].
Eigen::Vector2d bezier(const Eigen::RowVectorXd& coefficients, double t) {
  Eigen::RowVectorXd c = coefficients;
  const Eigen::Index n = c.size() - 1;
  double slope = 0;
  for (Eigen::Index level = 0; level < n; ++level) {
    if (level == n - 1) slope = static_cast<double>(n) * (c[1] - c[0]);
    for (Eigen::Index i = 0; i < n - level; ++i) c[i] = (1 - t) * c[i] + t * c[i + 1];
  }
  return {c[0], slope};
}

}  // namespace

Eigen::Vector3d Section::point(double v) const {
  const int span = find_span(knots, degree, v);
  const BasisValues N = basis_values(knots, degree, span, v);
  const Eigen::Vector4d h =
      control_points.middleCols(span - degree, degree + 1) * Eigen::Map<const Eigen::VectorXd>(N.data(), degree + 1);
  return h.head<3>() / h.w();
}

Section section(const RangeFunction& range, double z_mm) {
  require_cylinder(range, "section");
  const BaseSurface& base = range.base();
  if (!(z_mm >= base.band_start && z_mm <= base.band_end)) {
    throw std::invalid_argument("section: " + std::to_string(z_mm) + " mm is outside the band");
  }
  if (!base.arcs.closed()) throw std::invalid_argument("section: the arcs are open");
  const RangeFunction row = row_at(range, z_mm);
  const NurbsSurface extruded = symbolic_product(row);
  const BezierPatches patches(row);

  Section s;
  s.degree = extruded.degree_v;
  s.knots = extruded.knots_v;
  s.control_points = extruded.control_points.leftCols(extruded.count_v());
  const double radius = row.coefficients().cwiseAbs().maxCoeff();
  const Extrema radii = extrema(patches, 1e-12 * radius);
  s.largest_radius = radii.largest;
  s.smallest_radius = radii.smallest;
  s.largest_radius.z_mm = s.smallest_radius.z_mm = z_mm;

  Eigen::Vector2d first = Eigen::Vector2d::Zero();
  const GaussRule& rule = gauss_rule(points_across(row.degree_v()));
  for (std::size_t j = 0; j + 1 < patches.v().size(); ++j) {
    const double lo = patches.v()[j], width = patches.v()[j + 1] - lo;
    const Eigen::RowVectorXd coefficients = patches.patch(0, j).row(0);
    const auto speed = [&](double t) {  // arc length per t
      const Eigen::Vector2d f = bezier(coefficients, t);
      double theta_v = 0, theta_vv = 0;
      base.arcs.theta_derivatives(lo + width * t, theta_v, theta_vv);
      return std::hypot(f[0] * theta_v * width, f[1]);
    };
    s.perimeter_mm += integrate(speed, 0, 1, 12, s.perimeter_error_mm);
    for (std::size_t k = 0; k < rule.nodes.size(); ++k) {
      const double t = 0.5 * (1 + rule.nodes[k]), v = lo + width * t, r = bezier(coefficients, t)[0];
      double theta_v = 0, theta_vv = 0;
      base.arcs.theta_derivatives(v, theta_v, theta_vv);
      const double theta = base.arcs.theta_of_v(v), weight = 0.5 * rule.weights[k] * width * theta_v;
      s.area_mm2 += weight * r * r / 2;
      first += weight * r * r * r / 3 * Eigen::Vector2d(std::cos(theta), std::sin(theta));
    }
  }
  s.centroid_mm = base.X_WB * Eigen::Vector3d(first.x() / s.area_mm2, first.y() / s.area_mm2, z_mm);
  return s;
}

}  // namespace celadon
