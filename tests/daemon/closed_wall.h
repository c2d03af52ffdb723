#pragma once
// Walls in closed form for the tests: range functions given by their Bernstein coefficients on the four quarter
// circles, multiplied with the base circle by hand, and evaluated without any B-spline code.

#include <Eigen/Core>
#include <array>
#include <vector>

#include "fitting/nurbs_surface.h"

namespace celadon::testing {

/// r(u, v) = sum_i sum_k N_i(u) f(i, arc(v), k) B_k(frac(v)), z = z_start + u (z_end - z_start).
struct ClosedWall {
  int degree_u = 1, degree_v = 0;  ///< of the range function
  std::vector<double> knots_u = {0, 0, 1, 1};
  std::vector<std::array<std::vector<double>, 4>> bernstein;  ///< [i][arc][k], degree_v + 1 each, continuous around
  double z_start_mm = 0, z_end_mm = 100;

  double range_mm(double u, double v) const;
  Eigen::Vector3d point(double u, double v) const;
  static double theta_of_v(double v);
  /// Integral of r^2 / 2 dtheta dz by Gauss-Legendre quadrature on every knot rectangle.
  double volume_mm3() const;
  /// The exact surface of degree (max(degree_u, 1), degree_v + 2).
  NurbsSurface surface() const;
};

ClosedWall cylinder(double radius_mm, double height_mm);
/// A body of revolution of degree p in u with the given control ranges.
ClosedWall revolution(int degree_u, const std::vector<double>& control_ranges_mm, double height_mm);
/// A general wall of degrees (p, q) with lobes; deterministic.
ClosedWall lobed(int degree_u, int rows, int degree_v, double height_mm);

}  // namespace celadon::testing
