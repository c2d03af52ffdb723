#include "fitting/surface_comparison.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "fitting/gauss_legendre.h"

namespace celadon {
namespace {

double height_in_common(const RangeFunction& a, const RangeFunction& b) {
  return std::min(a.base().band_end, b.base().band_end) - std::max(a.base().band_start, b.base().band_start);
}

// Bernstein polynomials at t.
Eigen::VectorXd bernstein(int degree, double t) {
  Eigen::VectorXd N = Eigen::VectorXd::Zero(degree + 1);
  N[0] = 1;
  for (int d = 1; d <= degree; ++d)
    for (int i = d; i >= 0; --i) N[i] = (1 - t) * N[i] + (i > 0 ? t * N[i - 1] : 0);
  return N;
}

// Mean and mean square over theta and z. Along z the square is a polynomial and the rule exact; around, each point
// beyond the exact ones divides what is left of theta'(v) by 25.
Eigen::Vector2d means(const BezierPatches& difference) {
  const GaussRule& along = gauss_rule(difference.degree_u() + 1);
  const GaussRule& around = gauss_rule(difference.degree_v() + 13);
  const std::vector<double>&z = difference.z_mm(), &v = difference.v();
  const auto values = [](const GaussRule& rule, int degree) {
    Eigen::MatrixXd all(static_cast<Eigen::Index>(rule.nodes.size()), degree + 1);
    for (Eigen::Index k = 0; k < all.rows(); ++k) {
      all.row(k) = bernstein(degree, 0.5 * (1 + rule.nodes[static_cast<std::size_t>(k)])).transpose();
    }
    return all;
  };
  const Eigen::MatrixXd in_u = values(along, difference.degree_u()), in_v = values(around, difference.degree_v());
  const auto weights_u = Eigen::Map<const Eigen::VectorXd>(along.weights.data(), in_u.rows());
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  Eigen::VectorXd weights_v(in_v.rows());
  double measure = 0;
  for (std::size_t j = 0; j + 1 < v.size(); ++j) {
    const double half = (v[j + 1] - v[j]) / 2;
    for (Eigen::Index k = 0; k < in_v.rows(); ++k) {
      const auto node = static_cast<std::size_t>(k);
      double theta_v = 0, theta_vv = 0;
      difference.arcs().theta_derivatives(v[j] + half * (1 + around.nodes[node]), theta_v, theta_vv);
      weights_v[k] = half * around.weights[node] * theta_v;
    }
    for (std::size_t i = 0; i + 1 < z.size(); ++i) {
      const double dz = (z[i + 1] - z[i]) / 2;
      const Eigen::MatrixXd D = in_u * difference.patch(i, j) * in_v.transpose();
      sum[0] += dz * weights_u.dot(D * weights_v);
      sum[1] += dz * weights_u.dot(D.cwiseAbs2() * weights_v);
      measure += dz * 2 * weights_v.sum();
    }
  }
  return sum / measure;
}

}  // namespace

double SurfaceComparison::at_least_mm() const {
  return std::max(largest.value_mm, -smallest.value_mm);
}
double SurfaceComparison::at_most_mm() const {
  return std::max(largest.bound_mm, -smallest.bound_mm);
}

std::optional<SurfaceComparison> compare(const RangeFunction& a, const RangeFunction& b, double relative_width) {
  if (!(relative_width > 0)) throw std::invalid_argument("compare: the width of the bounds must be positive");
  if (!(height_in_common(a, b) > 0)) return std::nullopt;
  const BezierPatches difference(a, b);
  // The largest value at the corners of the patches: the largest difference is no less.
  double size = 0;
  for (std::size_t j = 0; j + 1 < difference.v().size(); ++j)
    for (std::size_t i = 0; i + 1 < difference.z_mm().size(); ++i) {
      const IntervalMatrix& c = difference.patch(i, j);
      const Eigen::Index p = c.rows() - 1, q = c.cols() - 1;
      size = std::max({size, std::abs(c(0, 0)), std::abs(c(p, 0)), std::abs(c(0, q)), std::abs(c(p, q))});
    }
  const Extrema found = extrema(difference, relative_width * size);
  const Eigen::Vector2d mean = means(difference);
  return SurfaceComparison{.z_start_mm = difference.z_mm().front(),
                           .z_end_mm = difference.z_mm().back(),
                           .largest = found.largest,
                           .smallest = found.smallest,
                           .mean_mm = mean[0],
                           .rms_mm = std::sqrt(mean[1])};
}

Eigen::MatrixXd signed_differences(const RangeFunction& a, const RangeFunction& b, std::span<const double> theta_rad,
                                   std::span<const double> z_mm) {
  if (a.base().X_WB.matrix() != b.base().X_WB.matrix()) {
    throw std::invalid_argument("signed_differences: the two functions have different frames");
  }
  const auto rows = static_cast<Eigen::Index>(z_mm.size()), columns = static_cast<Eigen::Index>(theta_rad.size());
  Eigen::MatrixXd all(rows, columns);
  std::vector<double> theta(z_mm.size()), r_a(z_mm.size()), r_b(z_mm.size());
  for (Eigen::Index j = 0; j < columns; ++j) {
    theta.assign(z_mm.size(), theta_rad[static_cast<std::size_t>(j)]);
    a.evaluate(theta.data(), z_mm.data(), theta.size(), r_a.data());
    b.evaluate(theta.data(), z_mm.data(), theta.size(), r_b.data());
    for (Eigen::Index i = 0; i < rows; ++i) {
      const auto k = static_cast<std::size_t>(i);
      const auto covers = [&](const RangeFunction& f) {
        return z_mm[k] >= f.base().band_start && z_mm[k] <= f.base().band_end;
      };
      all(i, j) = covers(a) && covers(b) ? r_a[k] - r_b[k] : std::numeric_limits<double>::quiet_NaN();
    }
  }
  return all;
}

}  // namespace celadon
