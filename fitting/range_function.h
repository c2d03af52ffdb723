#pragma once
// The single-valued B-spline (range) function F(u, v) over a cylindrical base, thesis (3.4).

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <vector>

#include "fitting/base_arcs.h"
#include "fitting/interval_basis.h"

namespace celadon {

/// The base cylinder of unit radius in its own frame: u in [0, 1] runs with z from z_start_mm to z_end_mm, v with
/// theta.
struct BaseCylinder {
  BaseArcs arcs = BaseArcs::full_circle();
  double z_start_mm = 0, z_end_mm = 1;
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();  ///< base frame in the scanner frame (lengths in mm)
};

/// r and its derivatives with respect to theta (mm/rad) and z (mm/mm).
struct RangeDerivatives {
  double r_mm = 0, r_theta = 0, r_z = 0, r_theta_theta = 0, r_theta_z = 0, r_z_z = 0;
};

/// Position, unit outward normal and principal curvatures (1/mm, positive for a convex body) of a surface point,
/// scanner frame.
struct SurfacePoint {
  Eigen::Vector3d p_W;
  Eigen::Vector3d normal_W;
  double curvature_max = 0, curvature_min = 0;
};

/// The surface's point where r has these derivatives. z in the base frame.
SurfacePoint surface_point(const BaseCylinder& base, double theta_rad, double z_mm, const RangeDerivatives& r);

class RangeFunction {
 public:
  RangeFunction() = default;
  /// @pre coefficients is (knots_u.size() - degree_u - 1) x (knots_v.size() - degree_v - 1); both knot vectors clamped,
  /// knots_u over [0, 1], knots_v over [0, base.arcs.count()]
  RangeFunction(BaseCylinder base, int degree_u, int degree_v, std::vector<double> knots_u, std::vector<double> knots_v,
                Eigen::MatrixXd coefficients);

  const BaseCylinder& base() const { return base_; }
  int degree_u() const { return degree_u_; }
  int degree_v() const { return degree_v_; }
  const std::vector<double>& knots_u() const { return knots_u_; }
  const std::vector<double>& knots_v() const { return knots_v_; }
  const Eigen::MatrixXd& coefficients() const { return coefficients_; }

  /// r at (theta, z) of the base frame; z clamped to the band.
  double operator()(double theta_rad, double z_mm) const;
  RangeDerivatives derivatives(double theta_rad, double z_mm) const;
  /// r at n points, SIMD; arrays of length n.
  void evaluate(const double* theta_rad, const double* z_mm, std::size_t n, double* r_mm) const;
  SurfacePoint surface_point(double theta_rad, double z_mm) const;
  /// F restricted to [z_start_mm, z_end_mm] by knot insertion; the same function there.
  /// @pre base().z_start_mm <= z_start_mm < z_end_mm <= base().z_end_mm
  RangeFunction clipped(double z_start_mm, double z_end_mm) const;
  /// e_p of a point of the scanner frame: its range minus F along its ray (positive outside), and e_p cos(psi).
  /// in_band false when z is outside the band.
  struct Membership {
    bool in_band;
    double ray_mm;
    double signed_distance_mm;
  };
  Membership membership(const Eigen::Vector3d& p_W) const;

 private:
  BaseCylinder base_;
  int degree_u_ = 0, degree_v_ = 0;
  std::vector<double> knots_u_, knots_v_;
  Eigen::MatrixXd coefficients_;

  double u_of_z(double z_mm) const;
  IntervalBasis basis_u_, basis_v_;
  Eigen::MatrixXd padded_;  // coefficients with zero rows and columns for the padding of the bases
};

}  // namespace celadon
