#pragma once
// What several fitting tests share: random spaces, values of a space's functions from its tables.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "fitting/range_function.h"
#include "fitting/range_space.h"

namespace celadon::test {

/// The test function of the convergence table: r = 30 + 3cos(2t+.3) + 1.5cos(5t+1) + .8 sin(3t).
inline double wavy_radius(double t) {
  return 30 + 3 * std::cos(2 * t + 0.3) + 1.5 * std::cos(5 * t + 1) + 0.8 * std::sin(3 * t);
}

inline double uniform(std::mt19937_64& random, double lo, double hi) {
  return std::uniform_real_distribution<double>(lo, hi)(random);
}

/// Breaks over four arcs with 1 to 6 intervals each, no two closer than a hundredth or so.
inline std::vector<double> random_closed_breaks(std::mt19937_64& random, int most = 6) {
  std::vector<double> breaks;
  for (int j = 0; j < 4; ++j) {
    const int m = std::uniform_int_distribution<int>(1, most)(random);
    std::vector<double> width(static_cast<std::size_t>(m));
    double total = 0;
    for (double& w : width) total += w = uniform(random, 0.05, 1);
    double at = 0;
    for (const double w : width) breaks.push_back(j + at / total), at += w;
  }
  breaks.push_back(4);
  return breaks;
}

/// Value and first two derivatives in t of a free function's sum, from the interval's tables.
inline Eigen::Vector3d from_tables(const RangeSpace& space, const Eigen::VectorXd& free, int interval, double t) {
  const double lo = space.breaks()[static_cast<std::size_t>(interval)];
  const double hi = space.breaks()[static_cast<std::size_t>(interval) + 1];
  const double s = 2 * (t - lo) / (hi - lo) - 1, ds = 2 / (hi - lo);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  const auto active = space.active(interval);
  for (std::size_t a = 0; a < active.size(); ++a) {
    const auto c = space.polynomial(interval, static_cast<int>(a));
    double p = 0, p1 = 0, p2 = 0;
    for (std::size_t k = c.size(); k-- > 0;) {
      p2 = p2 * s + 2 * p1;
      p1 = p1 * s + p;
      p = p * s + c[k];
    }
    sum += free[active[a]] * Eigen::Vector3d(p, p1 * ds, p2 * ds * ds);
  }
  return sum;
}

/// Interval of a space that holds t.
inline int interval_of(const RangeSpace& space, double t) {
  const auto& b = space.breaks();
  const auto above = std::upper_bound(b.begin(), b.end() - 1, t);
  return std::max(0, static_cast<int>(above - b.begin()) - 1);
}

/// Dense matrix of all free functions at many parameters.
inline Eigen::MatrixXd collocation(const RangeSpace& space, const Eigen::VectorXd& t) {
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(t.size(), space.free_count());
  for (Eigen::Index i = 0; i < t.size(); ++i) {
    const int interval = interval_of(space, t[i]);
    const double lo = space.breaks()[static_cast<std::size_t>(interval)];
    const double hi = space.breaks()[static_cast<std::size_t>(interval) + 1];
    const double s = 2 * (t[i] - lo) / (hi - lo) - 1;
    const auto active = space.active(interval);
    for (std::size_t a = 0; a < active.size(); ++a) {
      const auto c = space.polynomial(interval, static_cast<int>(a));
      double p = 0;
      for (std::size_t k = c.size(); k-- > 0;) p = p * s + c[k];
      A(i, active[a]) += p;
    }
  }
  return A;
}

/// Random breaks over [0, 1], 1 to 7 intervals.
inline std::vector<double> random_open_breaks(std::mt19937_64& random) {
  const int m = std::uniform_int_distribution<int>(1, 7)(random);
  std::vector<double> breaks{0};
  for (int k = 0; k < m; ++k) breaks.push_back(breaks.back() + uniform(random, 0.1, 1));
  for (double& t : breaks) t /= breaks.back();
  return breaks;
}

/// A rigid placement somewhere.
inline Eigen::Isometry3d random_placement(std::mt19937_64& random) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.linear() = Eigen::Quaterniond(uniform(random, -1, 1), uniform(random, -1, 1), uniform(random, -1, 1), 1)
                   .normalized()
                   .toRotationMatrix();
  X.translation() << uniform(random, -50, 50), uniform(random, -50, 50), uniform(random, -50, 50);
  return X;
}

/// Spaces of any degree: constants, splines, both kinds of closed space.
inline RangeSpace random_space_u(std::mt19937_64& random, int degree) {
  return degree == 0 ? RangeSpace::constant({0, 1}) : RangeSpace::open(degree, random_open_breaks(random));
}
inline RangeSpace random_space_v(std::mt19937_64& random, int degree) {
  if (degree == 0) return RangeSpace::constant({0, 1, 2, 3, 4});
  const auto kind = random() % 2 ? JointContinuity::curvature : JointContinuity::thesis;
  return RangeSpace::over(degree, BaseArcs::full_circle(), random_closed_breaks(random), kind);
}

/// A range function of random coefficients around 30 mm in the given spaces. @pre space_u over [0, 1]
inline RangeFunction random_function(std::mt19937_64& random, const RangeSpace& space_u, const RangeSpace& space_v,
                                     const BaseSurface& base, double spread = 4) {
  const Eigen::MatrixXd free = Eigen::MatrixXd::NullaryExpr(space_u.free_count(), space_v.free_count(),
                                                            [&] { return uniform(random, 30 - spread, 30 + spread); });
  const Eigen::MatrixXd in_v = space_v.extraction() * free.transpose();
  return {base,
          space_u.degree(),
          space_v.degree(),
          space_u.knots(),
          space_v.knots(),
          space_u.extraction() * in_v.transpose()};
}

}  // namespace celadon::test
