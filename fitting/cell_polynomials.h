#pragma once
// A range function as one polynomial a knot cell: values and slopes at millions of points, on SIMD lanes.
// Source: README.md, "Passes".

#include <cstddef>
#include <vector>

#include "fitting/aligned_allocator.h"
#include "fitting/interval_basis.h"
#include "fitting/range_function.h"

namespace celadon {

/// F = sum over a, b of c_ab s^a t^b on each cell of the knots, s and t its local coordinates in [-1, 1]. The
/// same as RangeFunction up to rounding; a point's values do not depend on its neighbours.
class CellPolynomials {
 public:
  explicit CellPolynomials(const RangeFunction& function);
  /// r at points (v, z), v as BaseArcs gives it; outside the band the rim's. Arrays of length n.
  void evaluate(const double* v, const double* z_mm, std::size_t n, double* r_mm) const;
  /// With r_theta (mm/rad) and r_z there, from the right at breaks. @pre the base arcs are those of the full circle
  void evaluate(const double* v, const double* z_mm, std::size_t n, double* r_mm, double* r_theta, double* r_z) const;

  /// What the kernels read: u = (z - z_start_mm()) per_height(), within [u_start(), u_end()].
  struct Cell {
    double start_u, end_u, start_v, end_v;  ///< half open; without end at the rims
    double origin_u, scale_u, origin_v, scale_v;
    const double* coefficients;  ///< c_ab at b * (degree_u + 1) + a
  };
  Cell cell_at(double u, double v, int& near_u, int& near_v) const;
  int degree_u() const { return basis_u_.degree(); }
  int degree_v() const { return basis_v_.degree(); }
  double z_start_mm() const { return z_start_; }
  double per_height() const { return per_height_; }
  double u_start() const { return u_start_; }
  double u_end() const { return u_end_; }
  /// theta_v = sine / (1 - bulge eta (1 - eta)) on the arcs, eta the part of v behind the joint.
  double sine() const { return sine_; }
  double bulge() const { return bulge_; }

 private:
  IntervalBasis basis_u_, basis_v_;
  double z_start_, per_height_, u_start_, u_end_, sine_, bulge_;
  AlignedVector<double> coefficients_;
};

}  // namespace celadon
