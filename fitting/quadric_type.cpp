#include "fitting/quadric_type.h"

#include <Eigen/Dense>
#include <cmath>
#include <stdexcept>

namespace celadon {
namespace {

using Vector9d = Eigen::Matrix<double, 9, 1>;

int sign_of(double value, double tolerance) {
  return value > tolerance ? 1 : value < -tolerance ? -1 : 0;
}

// How x' Q_u x depends on the coefficients, at two unit vectors a, b: a' Q_u b.
Vector9d form_terms(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  Vector9d t = Vector9d::Zero();
  t.head<3>() = a.cwiseProduct(b);
  t[3] = (a.x() * b.y() + a.y() * b.x()) / 2;
  t[4] = (a.y() * b.z() + a.z() * b.y()) / 2;
  t[5] = (a.z() * b.x() + a.x() * b.z()) / 2;
  return t;
}

// Without tolerances for what rank 3, 2, 1 leaves: signs of the eigenvalues, whether a linear term is left, sign of the
// constant.
QuadricType type_of(int positive, int negative, bool linear, int constant) {
  using enum QuadricType;
  const int rank = positive + negative;
  if (negative > positive) return type_of(negative, positive, linear, -constant);
  if (rank == 3) {
    if (negative == 0) return constant < 0 ? real_ellipsoid : constant > 0 ? imaginary_ellipsoid : imaginary_cone;
    return constant < 0 ? hyperboloid_of_one_sheet : constant > 0 ? hyperboloid_of_two_sheets : real_cone;
  }
  if (rank == 2) {
    if (linear) return negative == 0 ? elliptic_paraboloid : hyperbolic_paraboloid;
    if (negative == 1) return constant == 0 ? real_intersecting_planes : hyperbolic_cylinder;
    return constant < 0   ? real_elliptic_cylinder
           : constant > 0 ? imaginary_elliptic_cylinder
                          : imaginary_intersecting_planes;
  }
  if (rank == 1) {
    if (linear) return parabolic_cylinder;
    return constant < 0 ? real_parallel_planes : constant > 0 ? imaginary_parallel_planes : coincident_planes;
  }
  return none;
}

}  // namespace

const char* to_string(QuadricType type) {
  static constexpr const char* names[] = {"real ellipsoid",
                                          "imaginary ellipsoid",
                                          "hyperboloid of one sheet",
                                          "hyperboloid of two sheets",
                                          "real quadric cone",
                                          "imaginary quadric cone",
                                          "elliptic paraboloid",
                                          "hyperbolic paraboloid",
                                          "real elliptic cylinder",
                                          "imaginary elliptic cylinder",
                                          "hyperbolic cylinder",
                                          "real intersecting planes",
                                          "imaginary intersecting planes",
                                          "parabolic cylinder",
                                          "real parallel planes",
                                          "imaginary parallel planes",
                                          "coincident planes",
                                          "no quadric"};
  return names[static_cast<std::size_t>(type)];
}

QuadricType classify(const Quadric& quadric, const QuadricTolerance& tolerance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(quadric.Q_u);
  const Eigen::Vector3d beta = solver.eigenvectors().transpose() * quadric.v;
  int positive = 0, negative = 0;
  double constant = quadric.d, linear = 0;
  for (int j = 0; j < 3; ++j) {
    const double lambda = solver.eigenvalues()[j];
    const int sign = sign_of(lambda, tolerance.eigenvalues[j]);
    positive += sign > 0;
    negative += sign < 0;
    if (sign == 0) {
      linear = std::hypot(linear, beta[j]);
    } else {
      constant -= beta[j] * beta[j] / (4 * lambda);
    }
  }
  return type_of(positive, negative, linear > tolerance.linear, sign_of(constant, tolerance.constant));
}

QuadricType classify(const Quadric& quadric, const Eigen::Vector3d& centre, double size, double relative) {
  if (!(size > 0 && relative > 0)) throw std::invalid_argument("classify: size and tolerance must be positive");
  const Quadric q = quadric.centred(centre, size);
  const double largest = q.Q_u.selfadjointView<Eigen::Lower>().eigenvalues().cwiseAbs().maxCoeff();
  // Without squares the largest coefficient is the measure: then all of them count as zero.
  const double unit = std::max(largest, relative * q.v.cwiseAbs().maxCoeff());
  const double zero = relative * unit;
  // Completing the squares adds squares of the linear terms: rounding grows with them.
  const double square = q.v.squaredNorm() / std::max(unit, 1e-300);
  return classify(q, {Eigen::Vector3d::Constant(zero), zero, relative * std::max({unit, std::abs(q.d), square})});
}

Eigen::Vector3d eigenvalue_noise(const QuadricFit& fit) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(fit.normalised.Q_u);
  Eigen::Vector3d noise;
  for (int j = 0; j < 3; ++j) {
    const Vector9d t = form_terms(solver.eigenvectors().col(j), solver.eigenvectors().col(j));
    noise[j] = std::sqrt(std::max(0.0, t.dot(fit.covariance * t)));
  }
  return noise;
}

QuadricType classify(const QuadricFit& fit) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(fit.normalised.Q_u);
  const Eigen::Vector3d& lambda = solver.eigenvalues();
  const double floor = 1e-9 * lambda.cwiseAbs().maxCoeff();
  QuadricTolerance tolerance;
  tolerance.eigenvalues = (3 * eigenvalue_noise(fit)).cwiseMax(floor);
  // The slopes along axes without squares, and the constant: q is evaluated about the centre of the points.
  Eigen::Vector3d y = Eigen::Vector3d::Zero();
  double linear_variance = 0;
  for (int j = 0; j < 3; ++j) {
    const Eigen::Vector3d e = solver.eigenvectors().col(j);
    Vector9d t = Vector9d::Zero();
    t.tail<3>() = e;
    if (std::abs(lambda[j]) > tolerance.eigenvalues[j]) {
      y -= e * e.dot(fit.normalised.v) / (2 * lambda[j]);
    } else {
      linear_variance = std::max(linear_variance, t.dot(fit.covariance * t));
    }
  }
  tolerance.linear = std::max(floor, 3 * std::sqrt(linear_variance));
  // q at the vertex y, whose constant is minus the mean of the rest.
  Vector9d t = form_terms(y, y) - fit.mean_monomials;
  t.tail<3>() += y;
  tolerance.constant = std::max(floor, 3 * std::sqrt(std::max(0.0, t.dot(fit.covariance * t))));
  return classify(fit.normalised, tolerance);
}

}  // namespace celadon
