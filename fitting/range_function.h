#pragma once
// The single-valued B-spline (range) function F(u, v) over a cylinder or a sphere, thesis (3.4).

#include <Eigen/Core>
#include <vector>

#include "fitting/base_surface.h"
#include "fitting/interval_basis.h"

namespace celadon {

class RangeFunction {
 public:
  RangeFunction() = default;
  /// @pre coefficients is (knots_u.size() - degree_u - 1) x (knots_v.size() - degree_v - 1); both knot vectors clamped,
  /// knots_u over [0, 1], on a sphere over the band itself, knots_v over [0, base.arcs.count()]
  RangeFunction(BaseSurface base, int degree_u, int degree_v, std::vector<double> knots_u, std::vector<double> knots_v,
                Eigen::MatrixXd coefficients);

  const BaseSurface& base() const { return base_; }
  int degree_u() const { return degree_u_; }
  int degree_v() const { return degree_v_; }
  const std::vector<double>& knots_u() const { return knots_u_; }
  const std::vector<double>& knots_v() const { return knots_v_; }
  const Eigen::MatrixXd& coefficients() const { return coefficients_; }

  /// Below, `along` is z in mm on a cylinder and w on a sphere, as BaseSurface says; clamped to the band.
  /// The range at (theta, along) of the base frame.
  double operator()(double theta_rad, double along) const;
  RangeDerivatives derivatives(double theta_rad, double along) const;
  /// The range at n points, SIMD; arrays of length n.
  void evaluate(const double* theta_rad, const double* along, std::size_t n, double* r_mm) const;
  SurfacePoint surface_point(double theta_rad, double along) const;
  /// F restricted to [start, end] by knot insertion; the same function there.
  /// @pre base().band_start <= start < end <= base().band_end
  RangeFunction clipped(double start, double end) const;
  /// e_p of a point of the scanner frame: its range minus F along its ray (positive outside), and e_p cos(psi).
  /// in_band false when its coordinate along the base is outside the band.
  struct Membership {
    bool in_band;
    double ray_mm;
    double signed_distance_mm;
  };
  Membership membership(const Eigen::Vector3d& p_W) const;

 private:
  BaseSurface base_;
  int degree_u_ = 0, degree_v_ = 0;
  std::vector<double> knots_u_, knots_v_;
  Eigen::MatrixXd coefficients_;

  double u_of(double along) const;
  double u_along() const;
  IntervalBasis basis_u_, basis_v_;
  Eigen::MatrixXd padded_;  // coefficients with zero rows and columns for the padding of the bases
};

/// For what is made for cylinders with plane rims only. @throws std::invalid_argument naming `what` if the base is
/// another
void require_cylinder(const RangeFunction& function, const char* what);

}  // namespace celadon
