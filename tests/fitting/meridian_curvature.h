#pragma once
// Curvature of a horizontal section of a surface from evaluated points alone, from one side of a parameter.

#include <Eigen/Core>
#include <cmath>

#include "fitting/nurbs_surface.h"

namespace celadon::test {

/// Curvature (1/mm) at v of the section u = const by one-sided differences over 7 points v, v + step, ... (order 6 and
/// 5); a negative step looks to the left. @pre no knot within 6 steps but v itself
inline double one_sided_curvature(const NurbsSurface& surface, double u, double v, double step) {
  static constexpr double kFirst[] = {-49.0 / 20, 6, -15.0 / 2, 20.0 / 3, -15.0 / 4, 6.0 / 5, -1.0 / 6};
  static constexpr double kSecond[] = {203.0 / 45, -87.0 / 5, 117.0 / 4, -254.0 / 9, 33.0 / 2, -27.0 / 5, 137.0 / 180};
  const Eigen::Vector3d at = surface.evaluate(u, v);
  Eigen::Vector3d d1 = Eigen::Vector3d::Zero(), d2 = d1;
  for (int i = 1; i < 7; ++i) {  // the weights sum to zero: differences lose fewer digits than points
    const Eigen::Vector3d p = surface.evaluate(u, v + i * step) - at;
    d1 += kFirst[i] * p / step;
    d2 += kSecond[i] * p / (step * step);
  }
  return d1.cross(d2).z() / std::pow(d1.norm(), 3);
}

/// Curvature jump at v: from the right minus from the left; the seam v = 0 is also v = 4.
inline double curvature_jump(const NurbsSurface& surface, double u, double v, double step) {
  return one_sided_curvature(surface, u, v, step) - one_sided_curvature(surface, u, v == 0 ? 4 : v, -step);
}

}  // namespace celadon::test
