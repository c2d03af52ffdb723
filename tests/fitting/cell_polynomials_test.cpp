#include "fitting/cell_polynomials.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "fitting/range_space.h"

namespace celadon {
namespace {

// A random closed function over uneven breaks of a band that does not begin at 0.
RangeFunction random_function(int p, int q) {
  std::mt19937_64 random(static_cast<unsigned>(10 * p + q));
  std::uniform_real_distribution<double> share(0, 1);
  BaseSurface base;
  base.band_start = -7;
  base.band_end = 40;
  const auto u = p ? RangeSpace::open(p, {0, 0.03, 0.2, 0.5, 0.9, 1}) : RangeSpace::constant({0, 1});
  const auto v =
      q ? RangeSpace::over(q, base.arcs, 2, JointContinuity::curvature) : RangeSpace::constant({0, 1, 2, 3, 4});
  Eigen::MatrixXd free(u.free_count(), v.free_count());
  for (auto& c : free.reshaped()) c = 20 + 5 * share(random);
  return {base, p, q, u.knots(), v.knots(), u.extraction() * free * v.extraction().transpose()};
}

struct Evaluated {
  std::vector<double> r, r_theta, r_z, r_alone;
};
Evaluated evaluate(const CellPolynomials& cells, const std::vector<double>& v, const std::vector<double>& z) {
  Evaluated e;
  for (auto* array : {&e.r, &e.r_theta, &e.r_z, &e.r_alone}) array->resize(v.size());
  cells.evaluate(v.data(), z.data(), v.size(), e.r.data(), e.r_theta.data(), e.r_z.data());
  cells.evaluate(v.data(), z.data(), v.size(), e.r_alone.data());
  return e;
}

TEST(CellPolynomials, AreTheRangeFunctionAndItsSlopesAtAllDegrees) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> share(0, 1);
  for (int p = 0; p <= 5; ++p)
    for (int q = 0; q <= 5; ++q) {
      const RangeFunction f = random_function(p, q);
      std::vector<double> theta, v, z;
      for (int k = 0; k < 403; ++k) {  // runs within a cell and points anywhere, beyond the rims too
        theta.push_back(k % 50 < 30 ? 1 + 1e-3 * k : 2 * std::numbers::pi * share(random));
        z.push_back(k % 50 < 30 ? 0.1 * (k % 50) : -9 + 51 * share(random));
        v.push_back(f.base().arcs.v_of_theta(theta.back()));
      }
      const Evaluated e = evaluate(CellPolynomials(f), v, z);
      for (std::size_t k = 0; k < v.size(); ++k) {
        const RangeDerivatives d = f.derivatives(theta[k], z[k]);
        EXPECT_NEAR(e.r[k], d.r_mm, 1e-12) << p << ", " << q;
        EXPECT_EQ(e.r_alone[k], e.r[k]) << p << ", " << q;
        EXPECT_NEAR(e.r_theta[k], d.r_theta, 1e-10) << p << ", " << q << " at " << v[k];
        EXPECT_NEAR(e.r_z[k], d.r_z, 1e-10) << p << ", " << q << " at " << z[k];
      }
    }
}

TEST(CellPolynomials, APointDoesNotDependOnItsNeighbours) {
  const CellPolynomials cells(random_function(3, 3));
  std::vector<double> v, z;
  for (int k = 0; k < 97; ++k) {  // breaks of both directions among them
    v.push_back(k % 9 * 0.5);
    z.push_back(-7 + 47 * std::min(1.0, k % 11 * 0.1));
  }
  const Evaluated together = evaluate(cells, v, z);
  for (std::size_t k = 0; k < v.size(); ++k) {
    const Evaluated alone = evaluate(cells, {v[k]}, {z[k]});
    EXPECT_EQ(alone.r[0], together.r[k]);
    EXPECT_EQ(alone.r_theta[0], together.r_theta[k]);
    EXPECT_EQ(alone.r_z[0], together.r_z[k]);
  }
}

TEST(CellPolynomials, WhatIsNoNumberStaysByItself) {
  const RangeFunction f = random_function(3, 3);
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN(), kFar = std::numeric_limits<double>::infinity();
  const std::vector<double> v{0.3, kNone, 1.3, -1, 2.2, kFar, 3.1, 0.1}, z{1, 2, kNone, 4, 5, 6, kFar, -kFar};
  const Evaluated e = evaluate(CellPolynomials(f), v, z);
  for (const std::size_t k : {0u, 4u}) EXPECT_NEAR(e.r[k], f(f.base().arcs.theta_of_v(v[k]), z[k]), 1e-12);
  EXPECT_NEAR(e.r[6], f(f.base().arcs.theta_of_v(v[6]), 40), 1e-12);
  EXPECT_NEAR(e.r[7], f(f.base().arcs.theta_of_v(v[7]), -7), 1e-12);
}

}  // namespace
}  // namespace celadon
