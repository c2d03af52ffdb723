#include "fitting/round_shapes.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "fitting/robust_least_squares.h"

namespace celadon {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Least squares of A x = b, rows weighted, reweighted by what is left over `per`: residuals become millimetres.
Eigen::VectorXd reweighted(const Eigen::MatrixXd& A, const Eigen::VectorXd& b, const Eigen::VectorXd& weights,
                           const Eigen::VectorXd& per) {
  const Eigen::MatrixXd scaled = per.cwiseInverse().asDiagonal() * A;
  const Eigen::VectorXd target = b.cwiseQuotient(per);
  Eigen::VectorXd x, applied = weights;
  for (int round = 0; round < 6; ++round) {
    const Eigen::VectorXd root = applied.cwiseSqrt();
    x = (root.asDiagonal() * scaled).colPivHouseholderQr().solve(root.cwiseProduct(target));
    const Eigen::VectorXd left = scaled * x - target;
    const double scale = median_scale(left, weights);
    if (!(scale > 1e-12 * target.cwiseAbs().maxCoeff())) break;
    for (Eigen::Index k = 0; k < left.size(); ++k) applied[k] = weights[k] * tukey_weight(left[k], scale);
  }
  return x;
}

Eigen::Vector3d mean_of(const Eigen::Matrix3Xd& points, const Eigen::VectorXd& weights) {
  return points * weights / weights.sum();
}

// T_0 .. T_n at s with first and second derivatives.
struct Chebyshev {
  Eigen::VectorXd value, slope, bend;
  explicit Chebyshev(Eigen::Index count) : value(count), slope(count), bend(count) {}
  void at(double s) {
    value[0] = 1, slope[0] = 0, bend[0] = 0;
    if (value.size() > 1) value[1] = s, slope[1] = 1, bend[1] = 0;
    for (Eigen::Index n = 2; n < value.size(); ++n) {
      value[n] = 2 * s * value[n - 1] - value[n - 2];
      slope[n] = 2 * value[n - 1] + 2 * s * slope[n - 1] - slope[n - 2];
      bend[n] = 4 * slope[n - 1] + 2 * s * bend[n - 1] - bend[n - 2];
    }
  }
};

// What turning about i and j and shifting along them changes in local coordinates.
Eigen::Matrix<double, 3, 4> local_slopes(const Eigen::Vector3d& y) {
  Eigen::Matrix<double, 3, 4> s;
  s << 0, -y.z(), -1, 0,  //
      y.z(), 0, 0, -1,    //
      -y.y(), y.x(), 0, 0;
  return s;
}

}  // namespace

Sphere Sphere::moved(const Eigen::VectorXd& step) const {
  return {centre_mm + step.head<3>(), radius_mm + step[3]};
}

void Sphere::residuals(const Eigen::Matrix3Xd& points, Eigen::VectorXd& values, Eigen::MatrixXd* jacobian) const {
  const double least = 1e-12 * std::abs(radius_mm);
  for (Eigen::Index n = 0; n < points.cols(); ++n) {
    const Eigen::Vector3d x = points.col(n) - centre_mm;
    const double r = x.norm();
    values[n] = r - radius_mm;
    if (jacobian) jacobian->row(n) << -x.transpose() / std::max(r, least), -1;
  }
}

AxisFrame AxisFrame::moved(const Eigen::Vector4d& step) const {
  AxisFrame next;
  const Eigen::Vector3d turn = axes.leftCols<2>() * step.head<2>();
  const double angle = turn.norm();
  next.axes = angle > 0 ? Eigen::Matrix3d(Eigen::AngleAxisd(angle, turn / angle) * axes) : axes;
  next.point_mm = point_mm + axes.leftCols<2>() * step.tail<2>();
  return next;
}

Cone Cone::moved(const Eigen::VectorXd& step) const {
  Cone next = *this;
  next.axis = axis.moved(step.head<4>());
  next.radius_mm += step[4];
  if (!cylinder) next.slope += step[5];
  return next;
}

void Cone::residuals(const Eigen::Matrix3Xd& points, Eigen::VectorXd& values, Eigen::MatrixXd* jacobian) const {
  const double g = std::sqrt(1 + slope * slope), least = 1e-12 * std::abs(radius_mm) + 1e-300;
  for (Eigen::Index n = 0; n < points.cols(); ++n) {
    const Eigen::Vector3d y = axis.local(points.col(n));
    const double r = std::max(least, std::hypot(y.x(), y.y())), e = r - radius_mm - slope * y.z();
    values[n] = e / g;
    if (!jacobian) continue;
    const Eigen::RowVector3d by_y = Eigen::RowVector3d(y.x() / r, y.y() / r, -slope) / g;
    jacobian->row(n).head<4>() = by_y * local_slopes(y);
    (*jacobian)(n, 4) = -1 / g;
    if (!cylinder) (*jacobian)(n, 5) = -y.z() / g - e * slope / (g * g * g);
  }
}

MeridianSurface MeridianSurface::moved(const Eigen::VectorXd& step) const {
  MeridianSurface next = *this;
  next.axis = axis.moved(step.head<4>());
  next.coefficients += step.segment(4, coefficients.size());
  if (elliptic) {
    next.a += step[step.size() - 2];
    next.b += step[step.size() - 1];
  }
  return next;
}

void MeridianSurface::residuals(const Eigen::Matrix3Xd& points, Eigen::VectorXd& values,
                                Eigen::MatrixXd* jacobian) const {
  if (!(a * a + b * b < 1)) {
    values.setConstant(kNaN);
    return;
  }
  const Eigen::Index count = coefficients.size();
  Chebyshev T(count);
  // Where the gradient vanishes (an apex) E does so faster.
  const double least = 1e-6 * half_band_mm, least_square = least * least;
  for (Eigen::Index n = 0; n < points.cols(); ++n) {
    const Eigen::Vector3d y = axis.local(points.col(n));
    T.at(y.z() / half_band_mm);
    const double P_h = coefficients.dot(T.slope) / half_band_mm;
    const Eigen::Vector3d E_y(2 * ((1 + a) * y.x() + b * y.y()), 2 * ((1 - a) * y.y() + b * y.x()), -P_h);
    const double E = (y.x() * E_y.x() + y.y() * E_y.y()) / 2 - coefficients.dot(T.value);
    const bool steep = std::abs(P_h) > steepest_mm;
    const Eigen::Vector3d g(E_y.x(), E_y.y(), steep ? std::copysign(steepest_mm, -P_h) : -P_h);
    const double square = std::max(least_square, g.squaredNorm()), G = std::sqrt(square);
    values[n] = E / G;
    if (!jacobian) continue;
    // d(E/G) = dE/G - E/G^3 g . dg
    const double share = g.squaredNorm() > least_square ? E / (square * G) : 0;
    const double share_h = steep ? 0 : share;
    Eigen::Matrix3d bend = Eigen::Matrix3d::Zero();
    bend.topLeftCorner<2, 2>() << 2 * (1 + a), 2 * b, 2 * b, 2 * (1 - a);
    if (!steep) bend(2, 2) = -coefficients.dot(T.bend) / (half_band_mm * half_band_mm);
    const Eigen::RowVector3d by_y = E_y.transpose() / G - share * g.transpose() * bend;
    jacobian->row(n).head<4>() = by_y * local_slopes(y);
    jacobian->row(n).segment(4, count) =
        -T.value.transpose() / G + share_h * g.z() / half_band_mm * T.slope.transpose();
    if (!elliptic) continue;
    (*jacobian)(n, 4 + count) = (y.x() * y.x() - y.y() * y.y()) / G - share * 2 * (g.x() * y.x() - g.y() * y.y());
    (*jacobian)(n, 5 + count) = 2 * y.x() * y.y() / G - share * 2 * (g.x() * y.y() + g.y() * y.x());
  }
}

Sphere sphere_through(const Eigen::Matrix3Xd& points, const Eigen::VectorXd& weights) {
  const Eigen::Vector3d mean = mean_of(points, weights);
  const Eigen::Matrix3Xd y = points.colwise() - mean;
  Eigen::MatrixXd A(points.cols(), 4);
  A << 2 * y.transpose(), Eigen::VectorXd::Ones(points.cols());
  const Eigen::VectorXd x =
      reweighted(A, y.colwise().squaredNorm().transpose(), weights, Eigen::VectorXd::Ones(points.cols()));
  return {mean + x.head<3>(), std::sqrt(std::max(0.0, x[3] + x.head<3>().squaredNorm()))};
}

Cone cylinder_through(const Eigen::Matrix3Xd& points, const Eigen::VectorXd& weights,
                      const Eigen::Vector3d& direction) {
  Cone cone;
  cone.cylinder = true;
  const Eigen::Vector3d k = direction.normalized(), i = k.unitOrthogonal();
  cone.axis.axes << i, k.cross(i), k;
  const Eigen::Vector3d mean = mean_of(points, weights);
  const Eigen::Matrix2Xd y = cone.axis.axes.leftCols<2>().transpose() * (points.colwise() - mean);
  Eigen::MatrixXd A(points.cols(), 3);
  A << 2 * y.transpose(), Eigen::VectorXd::Ones(points.cols());
  const Eigen::VectorXd x =
      reweighted(A, y.colwise().squaredNorm().transpose(), weights, Eigen::VectorXd::Ones(points.cols()));
  cone.axis.point_mm = mean + cone.axis.axes.leftCols<2>() * x.head<2>();
  cone.radius_mm = std::sqrt(std::max(0.0, x[2] + x.head<2>().squaredNorm()));
  return cone;
}

MeridianSurface meridian_through(const Eigen::Matrix3Xd& points, const Eigen::VectorXd& weights, const AxisFrame& axis,
                                 int degree) {
  MeridianSurface surface;
  surface.axis = axis;
  surface.axis.point_mm += axis.axes.col(2) * axis.local(mean_of(points, weights)).z();
  const Eigen::Index N = points.cols();
  Eigen::VectorXd heights(N), squares(N);
  double low = 0, high = 0, largest = 0;
  for (Eigen::Index n = 0; n < N; ++n) {
    const Eigen::Vector3d y = surface.axis.local(points.col(n));
    heights[n] = y.z();
    squares[n] = y.head<2>().squaredNorm();
    if (!(weights[n] > 0)) continue;
    low = std::min(low, y.z());
    high = std::max(high, y.z());
    largest = std::max(largest, squares[n]);
  }
  surface.half_band_mm = std::max({-low, high, 1e-6 * std::sqrt(largest)});
  surface.steepest_mm = 4 * std::sqrt(largest);
  Chebyshev T(degree + 1);
  Eigen::MatrixXd A(N, degree + 1);
  for (Eigen::Index n = 0; n < N; ++n) {
    T.at(heights[n] / surface.half_band_mm);
    A.row(n) = T.value;
  }
  // E over twice the radius is the distance where the meridian does not lean; near the axis it is less.
  const Eigen::VectorXd per = (2 * squares.cwiseSqrt()).cwiseMax(0.1 * std::sqrt(largest));
  surface.coefficients = reweighted(A, squares, weights, per);
  return surface;
}

}  // namespace celadon
