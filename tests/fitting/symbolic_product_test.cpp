// S = F . B, thesis (A.2), (A.11), (B.3): against F times the unit circle at random points.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <numbers>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "fitting/knots.h"
#include "fitting/nurbs_surface.h"
#include "fitting/range_function.h"
#include "tests/fitting/meridian_curvature.h"
#include "tests/fitting/spline_tools.h"

namespace celadon {
namespace {

using std::numbers::pi;

BaseSurface band_between(double lo, double hi) {
  BaseSurface base;
  base.band_start = lo;
  base.band_end = hi;
  return base;
}

// What S must be, without NURBS: F along the direction of theta(v), z untouched.
Eigen::Vector3d truth(const RangeFunction& f, double u, double v) {
  const double theta = f.base().arcs.theta_of_v(v);
  const double z = (1 - u) * f.base().band_start + u * f.base().band_end;
  const double r = f(theta, z);
  return f.base().X_WB * Eigen::Vector3d(r * std::cos(theta), r * std::sin(theta), z);
}

RC_GTEST_PROP(SymbolicProduct, IsTheRangeFunctionTimesTheCircle_B_3, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int p = std::uniform_int_distribution<int>(0, 5)(random), q = std::uniform_int_distribution<int>(0, 5)(random);
  BaseSurface base = band_between(-20, 70);
  if (random() % 2) base.X_WB = test::random_placement(random);
  const RangeFunction f =
      test::random_function(random, test::random_space_u(random, p), test::random_space_v(random, q), base, 15);
  const NurbsSurface s = symbolic_product(f);
  RC_ASSERT(s.degree_u == std::max(p, 1));
  RC_ASSERT(s.degree_v == q + 2);
  RC_ASSERT(s.control_points.cols() == s.count_u() * s.count_v());
  const double size = 100;
  for (int k = 0; k < 60; ++k) {
    const double u = test::uniform(random, 0, 1), v = test::uniform(random, 0, 4);
    RC_ASSERT((s.evaluate(u, v) - truth(f, u, v)).norm() < 1e-12 * size);
  }
  for (int j = 0; j <= 4; ++j) RC_ASSERT((s.evaluate(0.5, j) - truth(f, 0.5, j)).norm() < 1e-12 * size);
  for (int i = 0; i < s.count_u(); ++i) {
    RC_ASSERT(s.control_point(i, 0) == s.control_point(i, s.count_v() - 1));  // coincide to the bit
  }
  RC_ASSERT(s.control_points.row(3).minCoeff() > 0);
  RC_ASSERT(s.control_points.row(3).maxCoeff() <= 1 + 1e-15);
}

RC_GTEST_PROP(SymbolicProduct, OpenRangesToo, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int q = std::uniform_int_distribution<int>(1, 5)(random);
  BaseSurface base = band_between(0, 50);
  base.arcs = BaseArcs::open(test::uniform(random, -3, 3), test::uniform(random, 0.2, 6.2));
  std::vector<double> breaks;
  for (double t = 0; t < base.arcs.count() - 0.2; t += test::uniform(random, 0.2, 0.6)) breaks.push_back(t);
  breaks.push_back(base.arcs.count());  // joints need not be knots of F
  const RangeFunction f =
      test::random_function(random, RangeSpace::open(3, {0, 0.3, 1}), RangeSpace::open(q, breaks), base);
  const NurbsSurface s = symbolic_product(f);
  RC_ASSERT(!s.closed_v);
  for (int k = 0; k < 60; ++k) {
    const double u = test::uniform(random, 0, 1), v = test::uniform(random, 0, base.arcs.count());
    RC_ASSERT((s.evaluate(u, v) - truth(f, u, v)).norm() < 1e-10);
  }
}

TEST(SymbolicProduct, CylinderIsExactAtDegrees_1_2) {
  const RangeFunction f(band_between(10, 30), 0, 0, {0, 1}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25));
  const NurbsSurface s = symbolic_product(f);
  EXPECT_EQ(s.degree_u, 1);
  EXPECT_EQ(s.degree_v, 2);
  EXPECT_EQ(s.count_u(), 2);
  EXPECT_EQ(s.count_v(), 9);
  EXPECT_EQ(s.knots_u, (std::vector<double>{0, 0, 1, 1}));
  EXPECT_EQ(s.knots_v, BaseArcs::full_circle().knots());
  for (int k = 0; k <= 1000; ++k) {
    const Eigen::Vector3d p = s.evaluate(0.3, k / 250.0);
    EXPECT_NEAR(p.head<2>().norm(), 25, 2e-14);
    EXPECT_NEAR(p.z(), 16, 1e-14);
  }
}

TEST(SymbolicProduct, RevolutionIsExactAtDegrees_p_2) {
  std::mt19937_64 random(3);
  for (int p = 1; p <= 5; ++p) {
    const RangeFunction f = test::random_function(random, test::random_space_u(random, p),
                                                  RangeSpace::constant({0, 1, 2, 3, 4}), band_between(0, 90));
    const NurbsSurface s = symbolic_product(f);
    EXPECT_EQ(s.degree_u, p);
    EXPECT_EQ(s.degree_v, 2);
    EXPECT_EQ(s.count_v(), 9);
    EXPECT_EQ(s.knots_u, f.knots_u());
    for (int k = 0; k < 200; ++k) {
      const double u = test::uniform(random, 0, 1), v = test::uniform(random, 0, 4);
      EXPECT_NEAR(s.evaluate(u, v).head<2>().norm(), f(0, 90 * u), 1e-13);
      EXPECT_NEAR(s.evaluate(u, v).z(), 90 * u, 1e-13);
    }
  }
}

TEST(SymbolicProduct, TranslationalHasDegrees_1_q2) {
  std::mt19937_64 random(4);
  const RangeFunction f = test::random_function(random, RangeSpace::constant({0, 1}),
                                                RangeSpace::over(3, BaseArcs::full_circle(), 4), band_between(0, 90));
  const NurbsSurface s = symbolic_product(f);
  EXPECT_EQ(s.degree_u, 1);
  EXPECT_EQ(s.degree_v, 5);
  EXPECT_EQ(s.count_u(), 2);
  EXPECT_LT((s.evaluate(0, 1.3) + Eigen::Vector3d(0, 0, 90) - s.evaluate(1, 1.3)).norm(), 1e-13);
}

// (A.7) with what can be removed left out: multiplicity m + 2 at a knot of multiplicity m of F inside an arc, full
// multiplicity q + 2 at the joints, where the arcs' denominator is only C0.
TEST(SymbolicProduct, KnotsHaveTheSmallestMultiplicities_A_7) {
  std::mt19937_64 random(5);
  for (int q = 1; q <= 5; ++q) {
    for (const auto kind : {JointContinuity::curvature, JointContinuity::thesis}) {
      const int m = 4;
      const RangeFunction f =
          test::random_function(random, RangeSpace::open(3, {0, 0.5, 1}),
                                RangeSpace::over(q, BaseArcs::full_circle(), m, kind), band_between(0, 90));
      const NurbsSurface s = symbolic_product(f);
      const Breaks breaks = breaks_of(s.knots_v);
      for (std::size_t k = 0; k < breaks.values.size(); ++k) {
        const double t = breaks.values[k];
        const bool end = t == 0 || t == 4, joint = t == std::floor(t);
        EXPECT_EQ(breaks.multiplicities[k], end ? q + 3 : joint ? q + 2 : 3) << t;
      }
      EXPECT_EQ(s.count_v(), 4 * (m - 1) * 3 + 4 * (q + 2) + 1);
      // Derivatives up to the continuity that is left are the same from both sides of an inner knot: F is C(q-1) there.
      if (q >= 3) {
        const double t = 0.25, h = 1e-9;
        const SurfaceDerivatives a = s.derivatives(0.4, t - h), b = s.derivatives(0.4, t);
        EXPECT_LT((a.S_vv - b.S_vv).norm(), 1e-4);
      }
    }
  }
}

TEST(SymbolicProduct, NormalPointsInwardAndVolumeIsPositive) {
  std::mt19937_64 random(6);
  const RangeFunction f =
      test::random_function(random, RangeSpace::open(3, {0, 0.5, 1}), RangeSpace::over(3, BaseArcs::full_circle(), 3),
                            band_between(0, 90), 5);
  const NurbsSurface s = symbolic_product(f);
  for (int k = 0; k < 200; ++k) {
    const double u = test::uniform(random, 0, 1), v = test::uniform(random, 0, 4);
    const SurfaceDerivatives d = s.derivatives(u, v);
    const Eigen::Vector3d n = d.S_u.cross(d.S_v).normalized();
    const SurfacePoint p = f.surface_point(f.base().arcs.theta_of_v(v), 90 * u);
    EXPECT_NEAR(n.dot(p.normal_W), -1, 1e-12);
    EXPECT_LT((p.p_W - d.S).norm(), 1e-12);
  }
  // Lateral part of the volume of a cylinder, integral of (x, y, 0)/2 over -S_u x S_v: pi R^2 h.
  const NurbsSurface c =
      symbolic_product({band_between(10, 30), 0, 0, {0, 1}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25)});
  double volume = 0;
  const int n = 4000;
  for (int k = 0; k < n; ++k) {
    const SurfaceDerivatives d = c.derivatives(0.5, 4 * (k + 0.5) / n);
    volume += Eigen::Vector3d(d.S.x(), d.S.y(), 0).dot(d.S_v.cross(d.S_u)) / 2 * 4 / n;
  }
  EXPECT_NEAR(volume, pi * 25 * 25 * 20, 5e-3);
}

// Second derivatives of the surface give the same curvature as the range function's own formulas.
TEST(SymbolicProduct, CurvatureOfTheSurfaceIsTheRangeFunctions) {
  std::mt19937_64 random(7);
  const RangeFunction f =
      test::random_function(random, RangeSpace::open(3, {0, 0.5, 1}), RangeSpace::over(3, BaseArcs::full_circle(), 3),
                            band_between(0, 90), 2);
  const NurbsSurface s = symbolic_product(f);
  for (int k = 0; k < 100; ++k) {
    const double u = test::uniform(random, 0, 1), v = test::uniform(random, 0, 4);
    const SurfaceDerivatives d = s.derivatives(u, v);
    const Eigen::Vector3d n = d.S_u.cross(d.S_v).normalized();  // inward: convex is positive
    Eigen::Matrix2d first, second;
    first << d.S_u.dot(d.S_u), d.S_u.dot(d.S_v), d.S_u.dot(d.S_v), d.S_v.dot(d.S_v);
    second << d.S_uu.dot(n), d.S_uv.dot(n), d.S_uv.dot(n), d.S_vv.dot(n);
    const Eigen::Vector2d kappa =
        Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::Matrix2d>(second, first).eigenvalues();
    const SurfacePoint p = f.surface_point(f.base().arcs.theta_of_v(v), 90 * u);
    EXPECT_NEAR(p.curvature_min, kappa[0], 1e-11);
    EXPECT_NEAR(p.curvature_max, kappa[1], 1e-11);
  }
}

// Finite differences of evaluated points on both sides of the four meridians where arcs meet.
TEST(SymbolicProduct, CurvatureDoesNotJumpAtTheMeridians) {
  std::mt19937_64 random(8);
  for (int q = 3; q <= 5; ++q) {
    for (const auto kind : {JointContinuity::curvature, JointContinuity::thesis}) {
      const RangeFunction f =
          test::random_function(random, RangeSpace::open(3, {0, 0.5, 1}),
                                RangeSpace::over(q, BaseArcs::full_circle(), 4, kind), band_between(0, 90), 1);
      const NurbsSurface s = symbolic_product(f);
      double largest = 0;
      for (int j = 0; j < 4; ++j) largest = std::max(largest, std::abs(test::curvature_jump(s, 0.3, j, 1.0 / 512)));
      if (kind == JointContinuity::curvature) {
        EXPECT_LT(largest, 1e-9) << q;  // rounding and truncation of the differences
      } else {
        EXPECT_GT(largest, 1e-4) << q;
      }
    }
  }
}

// Coefficients that close but for the rounding of whoever computed them still give one seam.
TEST(SymbolicProduct, SeamIsOneColumnOfControlPoints) {
  std::mt19937_64 random(10);
  const RangeFunction f = test::random_function(random, RangeSpace::open(3, {0, 0.5, 1}),
                                                RangeSpace::over(3, BaseArcs::full_circle(), 3), band_between(0, 90));
  Eigen::MatrixXd c = f.coefficients();
  c.rightCols(1) *= 1 + 1e-13;
  const NurbsSurface s = symbolic_product({f.base(), 3, 3, f.knots_u(), f.knots_v(), c});
  for (int i = 0; i < s.count_u(); ++i) EXPECT_EQ(s.control_point(i, 0), s.control_point(i, s.count_v() - 1));
  EXPECT_TRUE(s.closed_v);
}

TEST(SymbolicProduct, OpenSeamIsRefused) {
  const RangeFunction f(band_between(0, 1), 0, 1, {0, 1}, {0, 0, 1, 2, 3, 4, 4},
                        (Eigen::RowVectorXd(5) << 1, 1, 1, 1, 2).finished());
  EXPECT_THROW(symbolic_product(f), std::invalid_argument);
  EXPECT_THROW(symbolic_product(RangeFunction()), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
