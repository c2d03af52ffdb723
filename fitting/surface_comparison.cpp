#include "fitting/surface_comparison.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "fitting/gauss_legendre.h"

namespace celadon {
namespace {

double in_common(const RangeFunction& a, const RangeFunction& b) {
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

// Mean and mean square over theta and z, or over directions. Along z the square is a polynomial and the rule exact;
// around, and along a meridian, each point beyond the exact ones divides what is left of theta'(v) by 25.
Eigen::Vector2d means(const BezierPatches& difference, bool spherical) {
  const GaussRule& along = gauss_rule(difference.degree_u() + (spherical ? 13 : 1));
  const GaussRule& around = gauss_rule(difference.degree_v() + 13);
  const std::vector<double>&places = difference.along(), &v = difference.v();
  const auto values = [](const GaussRule& rule, int degree) {
    Eigen::MatrixXd all(static_cast<Eigen::Index>(rule.nodes.size()), degree + 1);
    for (Eigen::Index k = 0; k < all.rows(); ++k) {
      all.row(k) = bernstein(degree, 0.5 * (1 + rule.nodes[static_cast<std::size_t>(k)])).transpose();
    }
    return all;
  };
  const Eigen::MatrixXd in_u = values(along, difference.degree_u()), in_v = values(around, difference.degree_v());
  Eigen::VectorXd weights_u(in_u.rows());
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
    for (std::size_t i = 0; i + 1 < places.size(); ++i) {
      const double half_u = (places[i + 1] - places[i]) / 2;
      for (Eigen::Index k = 0; k < in_u.rows(); ++k) {
        const auto node = static_cast<std::size_t>(k);
        weights_u[k] = half_u * along.weights[node];
        if (!spherical) continue;
        const double w = places[i] + half_u * (1 + along.nodes[node]);
        double phi_w = 0, phi_ww = 0;
        BaseSurface::meridian().theta_derivatives(w, phi_w, phi_ww);
        weights_u[k] *= phi_w * std::sin(BaseSurface::meridian().theta_of_v(w));
      }
      const Eigen::MatrixXd D = in_u * difference.patch(i, j) * in_v.transpose();
      sum[0] += weights_u.dot(D * weights_v);
      sum[1] += weights_u.dot(D.cwiseAbs2() * weights_v);
      measure += weights_u.sum() * weights_v.sum();
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
  if (!(in_common(a, b) > 0)) return std::nullopt;
  const BezierPatches difference(a, b);
  // The largest value at the corners of the patches: the largest difference is no less.
  double size = 0;
  for (std::size_t j = 0; j + 1 < difference.v().size(); ++j)
    for (std::size_t i = 0; i + 1 < difference.along().size(); ++i) {
      const IntervalMatrix& c = difference.patch(i, j);
      const Eigen::Index p = c.rows() - 1, q = c.cols() - 1;
      size = std::max({size, std::abs(c(0, 0)), std::abs(c(p, 0)), std::abs(c(0, q)), std::abs(c(p, q))});
    }
  const Extrema found = extrema(difference, relative_width * size);
  const Eigen::Vector2d mean = means(difference, a.base().spherical());
  return SurfaceComparison{.start = difference.along().front(),
                           .end = difference.along().back(),
                           .largest = found.largest,
                           .smallest = found.smallest,
                           .mean_mm = mean[0],
                           .rms_mm = std::sqrt(mean[1])};
}

Eigen::MatrixXd signed_differences(const RangeFunction& a, const RangeFunction& b, std::span<const double> theta_rad,
                                   std::span<const double> along) {
  if (a.base().X_WB.matrix() != b.base().X_WB.matrix() || a.base().kind != b.base().kind ||
      a.base().heights != b.base().heights) {
    throw std::invalid_argument("signed_differences: the two functions have different frames or bases");
  }
  const auto rows = static_cast<Eigen::Index>(along.size()), columns = static_cast<Eigen::Index>(theta_rad.size());
  Eigen::MatrixXd all(rows, columns);
  std::vector<double> theta(along.size()), r_a(along.size()), r_b(along.size());
  for (Eigen::Index j = 0; j < columns; ++j) {
    theta.assign(along.size(), theta_rad[static_cast<std::size_t>(j)]);
    a.evaluate(theta.data(), along.data(), theta.size(), r_a.data());
    b.evaluate(theta.data(), along.data(), theta.size(), r_b.data());
    for (Eigen::Index i = 0; i < rows; ++i) {
      const auto k = static_cast<std::size_t>(i);
      const auto covers = [&](const RangeFunction& f) {
        return along[k] >= f.base().band_start && along[k] <= f.base().band_end;
      };
      all(i, j) = covers(a) && covers(b) ? r_a[k] - r_b[k] : std::numeric_limits<double>::quiet_NaN();
    }
  }
  return all;
}

}  // namespace celadon
