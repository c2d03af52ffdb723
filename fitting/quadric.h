#pragma once
// Quadric surfaces and their fit to points. Source: (4.1); Taubin 1991 for the normalisation; README.md, "Frames".

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>

namespace celadon {

/// The surface q(x) = x' Q_u x + v' x + d = 0, (4.1a). q and any multiple of it are one surface.
struct Quadric {
  Eigen::Matrix3d Q_u = Eigen::Matrix3d::Zero();  ///< symmetric
  Eigen::Vector3d v = Eigen::Vector3d::Zero();
  double d = 0;

  /// q_1 .. q_10 in the order of (4.1): x^2, y^2, z^2, xy, yz, zx, x, y, z, 1.
  static Quadric from_coefficients(const std::array<double, 10>& q);
  double value(const Eigen::Vector3d& x) const { return x.dot(Q_u * x) + v.dot(x) + d; }
  Eigen::Vector3d gradient(const Eigen::Vector3d& x) const { return 2 * Q_u * x + v; }
  Eigen::Matrix4d matrix() const;  ///< Q of (4.1b)
  /// The same surface for y, where x = centre + size y.
  Quadric centred(const Eigen::Vector3d& centre, double size) const;
};

/// A fitted quadric, in the coordinates of the points and in those of the fit, and what the residuals say of its
/// coefficients.
struct QuadricFit {
  Quadric quadric;     ///< millimetres; mean |grad q|^2 = 1, so that q is a distance near the surface
  Quadric normalised;  ///< for y = (x - centre)/size
  Eigen::Vector3d centre_mm = Eigen::Vector3d::Zero();
  double size_mm = 1;      ///< RMS of a coordinate about the centre
  double residual_mm = 0;  ///< RMS of q, less the nine coefficients: first order distance
  /// Of the first nine coefficients of `normalised`: (M - l B)^+ applied to both sides of the squared residuals' terms,
  /// so that uneven noise is seen (sandwich).
  Eigen::Matrix<double, 9, 9> covariance = Eigen::Matrix<double, 9, 9>::Zero();
  Eigen::Matrix<double, 9, 1> mean_monomials = Eigen::Matrix<double, 9, 1>::Zero();  ///< of y; d = -mean . q
  /// RMS of the next independent quadric: near `residual_mm` when more than one passes through the points (points of a
  /// curve).
  double next_residual_mm = 0;
};

/// Taubin's fit: the least sum of w q^2 with the mean of w |grad q|^2 fixed, which rotations, translations and scales
/// do not change. Points are centred and scaled to unit RMS, the constant is eliminated (d = -mean of the rest), and
/// the 9x9 pencil is solved.
/// @param points 3 x N, millimetres, finite  @param weights none, or N of them, not negative
/// @return nothing if fewer than ten points have weight, all coincide or lie on one plane or line
std::optional<QuadricFit> fit_quadric(const Eigen::Matrix3Xd& points, std::span<const double> weights = {});

}  // namespace celadon
