#pragma once
// Which of the 17 types a quadric is. Source: table 4.1; README.md, "Frames".

#include <Eigen/Core>
#include <cstdint>
#include <string>

#include "fitting/quadric.h"

namespace celadon {

/// In the order of table 4.1; `none` where no square is left (a plane, or nothing).
enum class QuadricType : std::uint8_t {
  real_ellipsoid,
  imaginary_ellipsoid,
  hyperboloid_of_one_sheet,
  hyperboloid_of_two_sheets,
  real_cone,
  imaginary_cone,
  elliptic_paraboloid,
  hyperbolic_paraboloid,
  real_elliptic_cylinder,
  imaginary_elliptic_cylinder,
  hyperbolic_cylinder,
  real_intersecting_planes,
  imaginary_intersecting_planes,
  parabolic_cylinder,
  real_parallel_planes,
  imaginary_parallel_planes,
  coincident_planes,
  none
};
const char* to_string(QuadricType type);  ///< "real ellipsoid", ...

/// Below which absolute values the parts of a quadric in principal axes count as zero.
struct QuadricTolerance {
  Eigen::Vector3d eigenvalues = Eigen::Vector3d::Zero();  ///< of Q_u, in ascending order of the eigenvalues
  double linear = 0;                                      ///< along axes whose eigenvalue is zero
  double constant = 0;                                    ///< what is left when the squares are complete
};

/// By the signs of the eigenvalues, of the linear term along axes without a square, and of the constant left. Sign and
/// scale of q do not matter if the tolerances are scaled too.
QuadricType classify(const Quadric& quadric, const QuadricTolerance& tolerance);

/// The same for points around `centre` in a region of about `size`, all tolerances `relative` to the largest eigenvalue
/// there: a hyperboloid that departs less from its cone is a cone.
/// @pre size > 0, relative > 0
QuadricType classify(const Quadric& quadric, const Eigen::Vector3d& centre, double size, double relative = 1e-9);

/// The same for a fit: what is below three standard deviations of the coefficients, or 1e-9 of the largest eigenvalue,
/// is zero.
QuadricType classify(const QuadricFit& fit);

/// Standard deviations of the eigenvalues (ascending) of `normalised.Q_u` from the fit's covariance, to first order.
Eigen::Vector3d eigenvalue_noise(const QuadricFit& fit);

}  // namespace celadon
