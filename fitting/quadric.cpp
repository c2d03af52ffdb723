#include "fitting/quadric.h"

#include <Eigen/Dense>
#include <cmath>

namespace celadon {
namespace {

using Vector9d = Eigen::Matrix<double, 9, 1>;
using Matrix9d = Eigen::Matrix<double, 9, 9>;

Vector9d monomials(const Eigen::Vector3d& y) {
  Vector9d m;
  m << y.x() * y.x(), y.y() * y.y(), y.z() * y.z(), y.x() * y.y(), y.y() * y.z(), y.z() * y.x(), y.x(), y.y(), y.z();
  return m;
}

Eigen::Matrix<double, 9, 3> gradients(const Eigen::Vector3d& y) {
  Eigen::Matrix<double, 9, 3> g = Eigen::Matrix<double, 9, 3>::Zero();
  g.topRows<3>().diagonal() = 2 * y;
  g.row(3) << y.y(), y.x(), 0;
  g.row(4) << 0, y.z(), y.y();
  g.row(5) << y.z(), 0, y.x();
  g.bottomRows<3>().setIdentity();
  return g;
}

Quadric quadric_of(const Vector9d& q, double d) {
  return Quadric::from_coefficients({q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7], q[8], d});
}

}  // namespace

Quadric Quadric::from_coefficients(const std::array<double, 10>& q) {
  Quadric s;
  s.Q_u << q[0], q[3] / 2, q[5] / 2, q[3] / 2, q[1], q[4] / 2, q[5] / 2, q[4] / 2, q[2];
  s.v << q[6], q[7], q[8];
  s.d = q[9];
  return s;
}

Eigen::Matrix4d Quadric::matrix() const {
  Eigen::Matrix4d Q;
  Q << Q_u, v / 2, v.transpose() / 2, d;
  return Q;
}

Quadric Quadric::centred(const Eigen::Vector3d& centre, double size) const {
  return {size * size * Q_u, size * gradient(centre), value(centre)};
}

std::optional<QuadricFit> fit_quadric(const Eigen::Matrix3Xd& points, std::span<const double> weights) {
  const Eigen::Index N = points.cols();
  const auto weight = [&](Eigen::Index k) { return weights.empty() ? 1.0 : weights[static_cast<std::size_t>(k)]; };
  QuadricFit fit;
  double total = 0, squares = 0, counted = 0;
  for (Eigen::Index k = 0; k < N; ++k) {
    total += weight(k);
    counted += weight(k) > 0;
    fit.centre_mm += weight(k) * points.col(k);
  }
  if (counted < 10) return std::nullopt;
  fit.centre_mm /= total;
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (Eigen::Index k = 0; k < N; ++k) {
    const Eigen::Vector3d y = points.col(k) - fit.centre_mm;
    spread += weight(k) / total * y * y.transpose();
  }
  squares = spread.trace();
  if (!(squares > 0) || !std::isfinite(squares)) return std::nullopt;
  const Eigen::Vector3d widths = spread.selfadjointView<Eigen::Lower>().eigenvalues();
  if (!(widths[0] > 1e-18 * widths[2])) return std::nullopt;
  fit.size_mm = std::sqrt(squares / 3);

  Vector9d& mean = fit.mean_monomials;
  for (Eigen::Index k = 0; k < N; ++k)
    mean += weight(k) / total * monomials((points.col(k) - fit.centre_mm) / fit.size_mm);
  Matrix9d M = Matrix9d::Zero(), B = Matrix9d::Zero();
  for (Eigen::Index k = 0; k < N; ++k) {
    const Eigen::Vector3d y = (points.col(k) - fit.centre_mm) / fit.size_mm;
    const Vector9d m = monomials(y) - mean;
    const Eigen::Matrix<double, 9, 3> g = gradients(y);
    M.noalias() += weight(k) / total * m * m.transpose();
    B.noalias() += weight(k) / total * g * g.transpose();
  }
  const Eigen::GeneralizedSelfAdjointEigenSolver<Matrix9d> pencil(M, B);
  if (pencil.info() != Eigen::Success || !pencil.eigenvectors().allFinite()) return std::nullopt;
  const Vector9d q = pencil.eigenvectors().col(0);  // q' B q = 1
  fit.next_residual_mm = std::sqrt(std::max(0.0, pencil.eigenvalues()[1])) * fit.size_mm;
  fit.normalised = quadric_of(q, -q.dot(mean));
  fit.quadric = fit.normalised.centred(-fit.centre_mm / fit.size_mm, 1 / fit.size_mm);
  // In millimetres the gradient is 1/size of that in y.
  fit.quadric.Q_u *= fit.size_mm;
  fit.quadric.v *= fit.size_mm;
  fit.quadric.d *= fit.size_mm;

  Matrix9d scores = Matrix9d::Zero();
  double residuals = 0;
  for (Eigen::Index k = 0; k < N; ++k) {
    const Vector9d m = monomials((points.col(k) - fit.centre_mm) / fit.size_mm) - mean;
    const double w = weight(k) / total, e = q.dot(m);
    residuals += w * e * e;
    scores.noalias() += w * w * e * e * m * m.transpose();
  }
  fit.residual_mm = std::sqrt(residuals * counted / (counted - 9)) * fit.size_mm;
  Matrix9d inverse = Matrix9d::Zero();
  for (int j = 1; j < 9; ++j) {
    const double gap = pencil.eigenvalues()[j] - pencil.eigenvalues()[0];
    if (gap > 0) inverse += pencil.eigenvectors().col(j) * pencil.eigenvectors().col(j).transpose() / gap;
  }
  fit.covariance = inverse * scores * inverse;
  return fit;
}

}  // namespace celadon
