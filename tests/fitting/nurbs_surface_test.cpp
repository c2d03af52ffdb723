#include "fitting/nurbs_surface.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "tests/fitting/spline_tools.h"

namespace celadon {
namespace {

// A hemisphere of revolution: degree (2, 2), radius 1, exact.
NurbsSurface hemisphere() {
  NurbsSurface s;
  s.degree_u = s.degree_v = 2;
  s.knots_u = {0, 0, 0, 1, 1, 1};
  const BaseArcs arcs = BaseArcs::full_circle();
  s.knots_v = arcs.knots();
  const auto circle = arcs.control_points();
  const double h = std::sqrt(0.5);
  const double meridian[3][3] = {{1, 0, 1}, {h, h, h}, {0, 1, 1}};  // homogeneous (r w, z w, w)
  s.control_points.resize(4, 27);
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 9; ++j) {
      const double w = circle(j, 2);
      s.control_points.col(i * 9 + j) << meridian[i][0] * circle(j, 0), meridian[i][0] * circle(j, 1),
          meridian[i][1] * w, meridian[i][2] * w;
    }
  }
  return s;
}

TEST(NurbsSurface, SphereSatisfiesItsIdentities) {
  const NurbsSurface s = hemisphere();
  std::mt19937_64 random(1);
  for (int k = 0; k < 500; ++k) {
    const double u = test::uniform(random, 0, 1), v = test::uniform(random, 0, 4);
    const SurfaceDerivatives d = s.derivatives(u, v);
    EXPECT_EQ(d.S, d.S);
    EXPECT_LT((d.S - s.evaluate(u, v)).norm(), 1e-15);
    EXPECT_NEAR(d.S.squaredNorm(), 1, 2e-15);
    // S.S = 1 differentiated once and twice
    EXPECT_NEAR(d.S.dot(d.S_u), 0, 1e-14);
    EXPECT_NEAR(d.S.dot(d.S_v), 0, 1e-14);
    EXPECT_NEAR(d.S.dot(d.S_uu) + d.S_u.squaredNorm(), 0, 1e-13);
    EXPECT_NEAR(d.S.dot(d.S_uv) + d.S_u.dot(d.S_v), 0, 1e-13);
    EXPECT_NEAR(d.S.dot(d.S_vv) + d.S_v.squaredNorm(), 0, 1e-13);
  }
}

TEST(NurbsSurface, DerivativesAgainstFiniteDifferences) {
  std::mt19937_64 random(2);
  for (int p = 1; p <= 5; ++p) {
    for (int q = 2; q <= 7; ++q) {
      NurbsSurface s;
      s.degree_u = p, s.degree_v = q;
      s.knots_u.assign(static_cast<std::size_t>(p) + 1, -1);
      s.knots_u.insert(s.knots_u.end(), {0.2, 0.6});
      s.knots_u.insert(s.knots_u.end(), static_cast<std::size_t>(p) + 1, 1);
      s.knots_v.assign(static_cast<std::size_t>(q) + 1, 0);
      s.knots_v.insert(s.knots_v.end(), {1, 1, 2.5});
      s.knots_v.insert(s.knots_v.end(), static_cast<std::size_t>(q) + 1, 4);
      s.control_points.resize(4, s.count_u() * s.count_v());
      for (Eigen::Index k = 0; k < s.control_points.cols(); ++k) {
        const double w = test::uniform(random, 0.7, 1.3);
        s.control_points.col(k) << w * test::uniform(random, -1, 1), w * test::uniform(random, -1, 1),
            w * test::uniform(random, -1, 1), w;
      }
      const double u = 0.37, v = 1.7, h = 1e-4;
      const auto S = [&](double a, double b) { return s.evaluate(u + a * h, v + b * h); };
      const SurfaceDerivatives d = s.derivatives(u, v);
      EXPECT_LT((d.S - S(0, 0)).norm(), 1e-15);
      EXPECT_LT((d.S_u - (S(1, 0) - S(-1, 0)) / (2 * h)).norm(), 1e-5);
      EXPECT_LT((d.S_v - (S(0, 1) - S(0, -1)) / (2 * h)).norm(), 1e-5);
      EXPECT_LT((d.S_uu - (S(1, 0) - 2 * S(0, 0) + S(-1, 0)) / (h * h)).norm(), 1e-4);
      EXPECT_LT((d.S_vv - (S(0, 1) - 2 * S(0, 0) + S(0, -1)) / (h * h)).norm(), 1e-4);
      EXPECT_LT((d.S_uv - (S(1, 1) - S(1, -1) - S(-1, 1) + S(-1, -1)) / (4 * h * h)).norm(), 1e-4);
    }
  }
}

TEST(NurbsSurface, KnotsAndEndsAreRobust) {
  const NurbsSurface s = hemisphere();
  EXPECT_EQ(s.evaluate(0, 0), Eigen::Vector3d(1, 0, 0));
  EXPECT_EQ(s.evaluate(0, 4), Eigen::Vector3d(1, 0, 0));
  EXPECT_EQ(s.evaluate(0, 1), Eigen::Vector3d(0, 1, 0));
  EXPECT_EQ(s.evaluate(0, 2), Eigen::Vector3d(-1, 0, 0));
  EXPECT_EQ(s.evaluate(1, 0.3), Eigen::Vector3d(0, 0, 1));
  EXPECT_EQ(s.evaluate(-3, 9), Eigen::Vector3d(1, 0, 0));
  for (int j = 0; j <= 4; ++j) {
    const SurfaceDerivatives d = s.derivatives(0, j);
    EXPECT_TRUE(d.S_vv.allFinite());
    EXPECT_NEAR(d.S_v.norm(), std::sqrt(2.0), 1e-15);  // theta' = 2 sin(arc/2) at an arc's ends
  }
  EXPECT_TRUE(s.derivatives(1, 4).S_uv.allFinite());
}

}  // namespace
}  // namespace celadon
