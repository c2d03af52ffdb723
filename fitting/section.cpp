#include "fitting/section.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

#include "fitting/bspline_basis.h"
#include "fitting/gauss_legendre.h"
#include "fitting/knots.h"
#include "fitting/nurbs_surface.h"

namespace celadon {
namespace {

constexpr int kMeridianSteps = 64, kHalvings = 48;
constexpr double kCurveError = 1e-8;  // of the radius
constexpr std::size_t kMostIntervals = 2048;

[[noreturn]] void refuse(double z_mm, const char* why) {
  throw std::invalid_argument("section: " + std::to_string(z_mm) + " mm " + why);
}

// r where the height is met at an angle.
double radius_at(const RangeFunction& range, double theta_rad, double z_mm) {
  const BaseSurface& base = range.base();
  if (!base.spherical()) {
    const double along = base.along_at(theta_rad, z_mm);
    if (!(along >= base.band_start && along <= base.band_end)) refuse(z_mm, "is outside the band at some angles");
    return range(theta_rad, along);
  }
  // z = rho cos(phi) falls along the meridian of a body that planes cut once.
  const auto above = [&](double w) {
    return range(theta_rad, w) * std::cos(BaseSurface::meridian().theta_of_v(w)) - z_mm;
  };
  double crossing = -1, before = above(base.band_start), at = base.band_start;
  for (int k = 1; k <= kMeridianSteps; ++k) {
    const double w = base.band_start + (base.band_end - base.band_start) * k / kMeridianSteps, after = above(w);
    if ((before > 0) != (after > 0)) {
      if (crossing >= 0) refuse(z_mm, "is met more than once along a meridian");
      crossing = at;
    }
    before = after, at = w;
  }
  if (crossing < 0) refuse(z_mm, "is outside the band at some angles");
  double lo = crossing, hi = crossing + (base.band_end - base.band_start) / kMeridianSteps;
  for (int k = 0; k < kHalvings; ++k) {
    const double middle = 0.5 * (lo + hi);
    (above(middle) > 0) == (above(lo) > 0) ? lo = middle : hi = middle;
  }
  const double w = 0.5 * (lo + hi);
  return range(theta_rad, w) * std::sin(BaseSurface::meridian().theta_of_v(w));
}

// Bezier coefficients of the polynomial with values at kNodes, and those nodes.
constexpr int kRowDegree = 5;
constexpr double kNodes[] = {0, 0.09549150281252627, 0.3454915028125263, 0.6545084971874737, 0.9045084971874737, 1};

Eigen::MatrixXd bezier_of_values() {
  Eigen::MatrixXd values(kRowDegree + 1, kRowDegree + 1);
  const std::vector<double> knots = clamped_knots(kRowDegree, std::vector<double>{0, 1});
  for (int k = 0; k <= kRowDegree; ++k) {
    const BasisValues N = basis_values(knots, kRowDegree, kRowDegree, kNodes[k]);
    values.row(k) = Eigen::Map<const Eigen::RowVectorXd>(N.data(), kRowDegree + 1);
  }
  return values.inverse();
}

// Polynomials through the radii at Chebyshev's extrema, over intervals halved until they lie near enough in between:
// between the knots of the surface r is analytic.
RangeFunction interpolated_row(const RangeFunction& range, double z_mm, double& error_mm) {
  BaseSurface base;
  base.arcs = range.base().arcs;
  base.X_WB = range.base().X_WB;
  base.band_start = z_mm;
  base.band_end = z_mm + 1;
  std::vector<double> breaks = breaks_of(range.knots_v()).values;
  if (range.base().heights)
    for (const double v : breaks_of(range.base().heights->knots_v()).values) breaks.push_back(v);
  for (int j = 0; j < base.arcs.count(); ++j) breaks.push_back(j);
  std::sort(breaks.begin(), breaks.end());
  breaks.erase(std::unique(breaks.begin(), breaks.end()), breaks.end());
  const Eigen::MatrixXd to_bezier = bezier_of_values();
  const auto radius = [&](double v) { return radius_at(range, base.arcs.theta_of_v(v), z_mm); };
  for (;;) {
    const std::size_t intervals = breaks.size() - 1;
    Eigen::RowVectorXd coefficients(static_cast<Eigen::Index>(kRowDegree * intervals + 1));
    for (std::size_t i = 0; i < intervals; ++i) {
      Eigen::VectorXd values(kRowDegree + 1);
      for (int k = 0; k <= kRowDegree; ++k) values[k] = radius(breaks[i] + kNodes[k] * (breaks[i + 1] - breaks[i]));
      coefficients.segment(static_cast<Eigen::Index>(kRowDegree * i), kRowDegree + 1) =
          (to_bezier * values).transpose();
    }
    coefficients[coefficients.size() - 1] = coefficients[0];
    const std::vector<double> knots =
        clamped_knots(kRowDegree, Breaks{breaks, std::vector<int>(breaks.size(), kRowDegree)});
    const RangeFunction row(base, 0, kRowDegree, {0, 1}, knots, coefficients);
    error_mm = 0;
    for (std::size_t i = 0; i < intervals; ++i)
      for (const double share : {0.04, 0.21, 0.5, 0.79, 0.96}) {
        const double v = breaks[i] + share * (breaks[i + 1] - breaks[i]);
        error_mm = std::max(error_mm, std::abs(row(base.arcs.theta_of_v(v), z_mm) - radius(v)));
      }
    if (error_mm <= kCurveError * coefficients.maxCoeff() || intervals >= kMostIntervals) return row;
    std::vector<double> halved;
    for (std::size_t k = 0; k < intervals; ++k)
      halved.insert(halved.end(), {breaks[k], 0.5 * (breaks[k] + breaks[k + 1])});
    halved.push_back(breaks.back());
    breaks = std::move(halved);
  }
}

// The function's row at a height, as one that is constant along z from there on.
RangeFunction row_at(const RangeFunction& range, double z_mm, double& error_mm) {
  BaseSurface base = range.base();
  if (base.spherical() || base.heights) return interpolated_row(range, z_mm, error_mm);
  if (!(z_mm >= base.band_start && z_mm <= base.band_end)) refuse(z_mm, "is outside the band");
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
  const BaseSurface& base = range.base();
  if (!base.arcs.closed()) throw std::invalid_argument("section: the arcs are open");
  Section s;
  const RangeFunction row = row_at(range, z_mm, s.curve_error_mm);
  const NurbsSurface extruded = symbolic_product(row);
  const BezierPatches patches(row);

  s.degree = extruded.degree_v;
  s.knots = extruded.knots_v;
  s.control_points = extruded.control_points.leftCols(extruded.count_v());
  const double radius = row.coefficients().cwiseAbs().maxCoeff();
  const Extrema radii = extrema(patches, 1e-12 * radius);
  s.largest_radius = radii.largest;
  s.smallest_radius = radii.smallest;
  s.largest_radius.along = s.smallest_radius.along = z_mm;

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
