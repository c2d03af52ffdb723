#pragma once
// Solids in closed form as rational surfaces, made without the code under test, and triangulations of surfaces.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <random>
#include <vector>

#include "fitting/nurbs_surface.h"
#include "fitting/range_function.h"
#include "tests/fitting/spline_tools.h"

namespace celadon::test {

inline BaseSurface band(double lo, double hi) {
  BaseSurface base;
  base.band_start = lo;
  base.band_end = hi;
  return base;
}

/// Rows (w r, w z, w) of a meridian's control points, turned about z by the arcs.
inline NurbsSurface revolved(int degree, std::vector<double> knots, const Eigen::MatrixX3d& meridian) {
  NurbsSurface s;
  const BaseArcs arcs = BaseArcs::full_circle();
  const Eigen::MatrixX3d circle = arcs.control_points();
  s.degree_u = degree;
  s.knots_u = std::move(knots);
  s.knots_v = arcs.knots();
  s.control_points.resize(4, meridian.rows() * circle.rows());
  for (Eigen::Index i = 0; i < meridian.rows(); ++i)
    for (Eigen::Index j = 0; j < circle.rows(); ++j)
      s.control_points.col(i * circle.rows() + j) << meridian(i, 0) * circle(j, 0), meridian(i, 0) * circle(j, 1),
          meridian(i, 1) * circle(j, 2), meridian(i, 2) * circle(j, 2);
  return s;
}

/// The sphere of radius R about the origin between the latitudes, poles where they are +-90 degrees.
inline NurbsSurface sphere(double R, double from_rad, double to_rad) {
  const BaseArcs arcs = BaseArcs::open(from_rad, to_rad - from_rad);
  Eigen::MatrixX3d meridian = arcs.control_points();
  meridian.leftCols<2>() *= R;
  for (const Eigen::Index end : {Eigen::Index{0}, meridian.rows() - 1})
    if (std::abs(meridian(end, 0)) < 1e-12 * R) meridian(end, 0) = 0;
  return revolved(2, arcs.knots(), meridian);
}

/// A tube of radius r along a ring of radius R about z, from angle 0 on.
inline NurbsSurface torus_segment(double R, double r, double angle_rad) {
  const BaseArcs ring = BaseArcs::open(0, angle_rad), tube = BaseArcs::full_circle();
  const Eigen::MatrixX3d along = ring.control_points(), around = tube.control_points();
  NurbsSurface s;
  s.degree_u = 2;
  s.knots_u = ring.knots();
  s.knots_v = tube.knots();
  s.control_points.resize(4, along.rows() * around.rows());
  for (Eigen::Index i = 0; i < along.rows(); ++i)
    for (Eigen::Index j = 0; j < around.rows(); ++j) {
      const double radial = R * around(j, 2) + r * around(j, 0), w = around(j, 2);
      s.control_points.col(i * around.rows() + j) << radial * along(i, 0), radial * along(i, 1),
          r * around(j, 1) * along(i, 2), w * along(i, 2);
    }
  return s;
}

/// A revolution with the meridian r(z) = sum c_k (z/h)^k over [0, h], one Bezier segment.
inline RangeFunction polynomial_revolution(const std::vector<double>& c, double h) {
  const auto p = static_cast<int>(c.size()) - 1;
  Eigen::MatrixXd bezier = Eigen::MatrixXd::Zero(p + 1, 1);
  const auto choose = [](int n, int k) {
    return std::round(std::exp(std::lgamma(n + 1) - std::lgamma(k + 1) - std::lgamma(n - k + 1)));
  };
  for (int i = 0; i <= p; ++i)
    for (int k = 0; k <= i; ++k) bezier(i) += choose(i, k) / choose(p, k) * c[static_cast<std::size_t>(k)];
  std::vector<double> knots(static_cast<std::size_t>(p) + 1, 0.0);
  knots.insert(knots.end(), static_cast<std::size_t>(p) + 1, 1.0);
  if (p == 0) knots = {0, 1};
  return {band(0, h), p, 0, knots, {0, 4}, bezier};
}

/// A closed freeform body of random degrees.
inline RangeFunction random_body(std::mt19937_64& random, const BaseSurface& base, double spread = 4) {
  const int p = std::uniform_int_distribution<int>(0, 5)(random), q = std::uniform_int_distribution<int>(0, 5)(random);
  return random_function(random, random_space_u(random, p), random_space_v(random, q), base, spread);
}

/// Volume, area and first moments of the body's triangulation, n intervals each way, fans at the ends. Outward
/// where S_u x S_v points inward.
struct MeshProperties {
  double volume = 0, area = 0;
  Eigen::Vector3d first = Eigen::Vector3d::Zero();
};
inline MeshProperties triangulated(const NurbsSurface& s, int n) {
  MeshProperties mesh;
  const auto add = [&](const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
    const double tetrahedron = a.dot(b.cross(c)) / 6;
    mesh.volume += tetrahedron;
    mesh.first += tetrahedron * (a + b + c) / 4;
    mesh.area += (b - a).cross(c - a).norm() / 2;
  };
  const auto at = [&](int i, int j) {
    return s.evaluate(s.knots_u.front() + (s.knots_u.back() - s.knots_u.front()) * i / n,
                      s.knots_v.front() + (s.knots_v.back() - s.knots_v.front()) * (j % n) / n);
  };
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      add(at(i, j), at(i, j + 1), at(i + 1, j + 1));
      add(at(i, j), at(i + 1, j + 1), at(i + 1, j));
    }
    add(at(0, 0), at(0, j + 1), at(0, j));
    add(at(n, 0), at(n, j), at(n, j + 1));
  }
  return mesh;
}

}  // namespace celadon::test
