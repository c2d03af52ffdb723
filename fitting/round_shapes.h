#pragma once
// Sphere, cylinder, cone and surfaces around an axis as shapes for robust fits: residuals in millimetres with analytic
// Jacobians. Source: README.md, "Frames".

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace celadon {

/// Residual |x - centre| - radius, the distance. Unknowns: centre, radius.
struct Sphere {
  Eigen::Vector3d centre_mm = Eigen::Vector3d::Zero();
  double radius_mm = 1;

  int unknowns() const { return 4; }
  Sphere moved(const Eigen::VectorXd& step) const;
  void residuals(const Eigen::Matrix3Xd& points, Eigen::VectorXd& values, Eigen::MatrixXd* jacobian) const;
};

/// A line with a frame: columns i, j, k of `axes`, k along it. The first four unknowns of every shape around an axis
/// are turns about i and j (radians) and shifts along them.
struct AxisFrame {
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();
  Eigen::Vector3d point_mm = Eigen::Vector3d::Zero();

  AxisFrame moved(const Eigen::Vector4d& step) const;
  Eigen::Vector3d local(const Eigen::Vector3d& x) const { return axes.transpose() * (x - point_mm); }
};

/// Residual (r - radius - slope h)/sqrt(1 + slope^2), the distance; a cylinder where the slope is not an unknown.
/// Unknowns: the axis, radius, slope.
struct Cone {
  AxisFrame axis;
  double radius_mm = 1;  ///< at the axis's point
  double slope = 0;      ///< of the radius along k
  bool cylinder = false;

  int unknowns() const { return cylinder ? 5 : 6; }
  Cone moved(const Eigen::VectorXd& step) const;
  void residuals(const Eigen::Matrix3Xd& points, Eigen::VectorXd& values, Eigen::MatrixXd* jacobian) const;
};

/// E(x) = X^2 + Y^2 + a (X^2 - Y^2) + 2 b X Y - P(h), with a polynomial P of the height: a surface of revolution for a
/// = b = 0, which passes through its poles; with a, b similar ellipses at all heights. Quadratic P gives all quadrics
/// that table 4.1 finds an axis for. Residual E/|grad E|, the distance to first order. Unknowns: the axis, the
/// Chebyshev coefficients of P in h/half_band_mm, then a and b if `elliptic`.
struct MeridianSurface {
  AxisFrame axis;
  double half_band_mm = 1;
  double steepest_mm = 1e300;
  Eigen::VectorXd coefficients;  ///< mm^2
  bool elliptic = false;
  double a = 0, b = 0;  ///< a^2 + b^2 < 1

  int unknowns() const { return 4 + static_cast<int>(coefficients.size()) + (elliptic ? 2 : 0); }
  MeridianSurface moved(const Eigen::VectorXd& step) const;
  void residuals(const Eigen::Matrix3Xd& points, Eigen::VectorXd& values, Eigen::MatrixXd* jacobian) const;
};

/// Starts: linear least squares, reweighted a few times by the residuals' median.
/// @pre as many points with weight as unknowns, not all in a plane for the sphere
Sphere sphere_through(const Eigen::Matrix3Xd& points, const Eigen::VectorXd& weights);
/// About an axis of this direction: the circle through the points seen along it. Its point is beside the points' mean.
Cone cylinder_through(const Eigen::Matrix3Xd& points, const Eigen::VectorXd& weights, const Eigen::Vector3d& direction);
/// About a given axis, with a polynomial of this degree, a = b = 0. The axis's point is moved beside the points' mean;
/// steepest_mm is four times the largest radius (a sphere's pole has twice).
MeridianSurface meridian_through(const Eigen::Matrix3Xd& points, const Eigen::VectorXd& weights, const AxisFrame& axis,
                                 int degree);

}  // namespace celadon
