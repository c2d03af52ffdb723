#pragma once
// The bending energy of a range function in millimetres, as a sum of products of one-dimensional Gram matrices:
//   E(F) = integral of r_zz^2 + 2 r_zs^2 + r_ss^2 dz ds,  s = r_mean theta,  r_thetatheta = F_vv v'^2 + F_v v''
//        = U2 x V0 + 2 U1 x V1 + U0 x V2 over free coefficients. Source: README.md, "Smoothing".

#include <Eigen/Core>
#include <array>

#include "fitting/base_arcs.h"
#include "fitting/range_space.h"
#include "fitting/stencil_matrix.h"

namespace celadon {

/// Integrals of the products of k-th derivatives, k = 0, 1, 2, of a space's free functions.
using GramMatrices = std::array<Eigen::MatrixXd, 3>;

/// With respect to the space's own parameter (z in mm for the spaces along u).
GramMatrices gram_matrices(const RangeSpace& space);
/// With respect to arc length r_mean_mm * theta, of a space over the arcs' v.
GramMatrices gram_matrices(const RangeSpace& space, const BaseArcs& arcs, double r_mean_mm);

/// The energy of a pair of spaces.
struct BendingEnergy {
  // Over a sphere, along_u holds what stands beside along_v[0..2] in its energy.
  GramMatrices along_u, along_v;
  /// The trace of its matrix.
  double trace() const;
  /// Of free coefficients, count_u x count_v.
  double of(const Eigen::MatrixXd& free) const;
  /// matrix += factor * energy. @pre the matrix belongs to the same pair of spaces
  void add_to(StencilMatrix& matrix, double factor) const;
};

/// Over a sphere of unit radius, u along the meridian: the integral of the covariant second derivatives' squares,
///   rho_pp^2 s + 2 (rho_pt - c/s rho_t)^2 / s + (rho_tt + s c rho_p)^2 / s^3  over phi (p) and theta (t),
/// s = sin phi, c = cos phi; around an open range of theta without the products of rho_tt and rho_p, whose integral by
/// parts leaves terms at its ends.
BendingEnergy spherical_energy(const RangeSpace& u, const RangeSpace& v, const BaseArcs& around);

}  // namespace celadon
