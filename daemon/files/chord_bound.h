#pragma once
// Proof that a mesh cell lies within a chord tolerance of a range function. Derivation in README.md, "Meshes".

#include <vector>

#include "fitting/range_function.h"

namespace celadon {

/// Bounds that hold on a piece of the parameter rectangle.
struct RangeBounds {
  double r_max = 0;          ///< |r|
  double bend = 0;           ///< |r_thetatheta - r|
  double slope_max = 0;      ///< |r_theta / r|
  double r_z = 0;            ///< |r_z|
  double r_theta_z = 0;      ///< |r_thetaz|
  double r_zz = 0;           ///< |r_zz|
  double r_theta = 0;        ///< |r_theta|
  double r_theta_theta = 0;  ///< |r_thetatheta|
  void widen(const RangeBounds& other);
};

/// Bounds of a range function on rectangles between its knots, from the convex hulls of the Bezier coefficients of the
/// function and its derivatives.
class BoundTable {
 public:
  explicit BoundTable(const RangeFunction& range);

  /// Borders between the intervals, ascending: z in mm, theta in radians.
  const std::vector<double>& z_mm() const { return z_; }
  const std::vector<double>& theta_rad() const { return theta_; }
  /// Whether the function may have a kink (less than C1) where an interval starts: a grid line must follow it.
  const std::vector<bool>& z_kink() const { return z_kink_; }
  const std::vector<bool>& theta_kink() const { return theta_kink_; }
  const RangeBounds& at(std::size_t z_interval, std::size_t theta_interval) const {
    return bounds_[z_interval * (theta_.size() - 1) + theta_interval];
  }

 private:
  std::vector<double> z_, theta_;
  std::vector<bool> z_kink_, theta_kink_;
  std::vector<RangeBounds> bounds_;
};

/// Corner ranges of a cell [theta0, theta0 + h_theta] x [z0, z0 + h_z]: r00 at both starts, r10 at the end of theta.
struct CellCorners {
  double r00, r10, r01, r11;
};

/// No point of the wall over the cell is further than this from the two triangles that share the diagonal 00 - 11.
/// Infinite where nothing can be proved. @pre 0 < h_theta_rad < pi
double chord_bound_mm(const RangeBounds& bounds, const CellCorners& corners, double h_theta_rad, double h_z_mm);

/// Bounds on the derivatives of a base's heights, all over it; 0 where its rims are plane.
struct HeightBounds {
  double theta = 0, theta_theta = 0, theta_along = 0;  ///< |z_theta|, |z_thetatheta|, |z_theta along|
};
HeightBounds height_bounds(const BaseSurface& base);

/// By how much the height of the wall and of the triangles differ where they are seen at the same angle and coordinate
/// along: what adds to chord_bound_mm where the rims are not plane.
double height_bound_mm(const HeightBounds& heights, const CellCorners& corners, double h_theta_rad, double h_along_mm);

}  // namespace celadon
