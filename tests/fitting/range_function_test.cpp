#include "fitting/range_function.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <numbers>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "fitting/bspline_basis.h"
#include "tests/fitting/spline_tools.h"

namespace celadon {
namespace {

using std::numbers::pi;

BaseSurface band(double lo, double hi) {
  BaseSurface base;
  base.band_start = lo;
  base.band_end = hi;
  return base;
}

// A revolution with a polynomial meridian r(z) = sum c_k (z/60)^k over z in [0, 60]: one Bezier segment in u.
RangeFunction revolution(const std::vector<double>& c) {
  const int p = static_cast<int>(c.size()) - 1;
  Eigen::MatrixXd bezier = Eigen::MatrixXd::Zero(p + 1, 1);
  for (int i = 0; i <= p; ++i) {
    for (int k = 0; k <= i; ++k) bezier(i) += binomial(i, k) / binomial(p, k) * c[static_cast<std::size_t>(k)];
  }
  std::vector<double> knots(static_cast<std::size_t>(p) + 1, 0.0);
  knots.insert(knots.end(), static_cast<std::size_t>(p) + 1, 1.0);
  return {band(0, 60), p, 0, knots, {0, 4}, bezier};
}

// Tensor sum over all B-splines, by the basis functions.
double direct(const RangeFunction& f, double theta, double z) {
  const double v = f.base().arcs.v_of_theta(theta);
  const double u = std::clamp((z - f.base().band_start) / (f.base().band_end - f.base().band_start), 0.0, 1.0);
  const int su = find_span(f.knots_u(), f.degree_u(), u), sv = find_span(f.knots_v(), f.degree_v(), v);
  const auto Nu = basis_values(f.knots_u(), f.degree_u(), su, u), Nv = basis_values(f.knots_v(), f.degree_v(), sv, v);
  double sum = 0;
  for (int i = 0; i <= f.degree_u(); ++i) {
    for (int j = 0; j <= f.degree_v(); ++j) {
      sum += Nu[static_cast<std::size_t>(i)] * Nv[static_cast<std::size_t>(j)] *
             f.coefficients()(su - f.degree_u() + i, sv - f.degree_v() + j);
    }
  }
  return sum;
}

RC_GTEST_PROP(RangeFunction, BatchAgreesWithTheTensorSum, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int p = std::uniform_int_distribution<int>(0, 5)(random), q = std::uniform_int_distribution<int>(0, 5)(random);
  const RangeFunction f =
      test::random_function(random, test::random_space_u(random, p), test::random_space_v(random, q), band(-20, 70));
  std::vector<double> theta(600), z(600), r(600);
  for (std::size_t k = 0; k < theta.size(); ++k) {
    theta[k] = test::uniform(random, -7, 7);
    z[k] = test::uniform(random, -25, 75);
  }
  theta[0] = 0, theta[1] = 2 * pi, z[2] = -20, z[3] = 70;
  f.evaluate(theta.data(), z.data(), theta.size(), r.data());
  for (std::size_t k = 0; k < theta.size(); ++k) {
    RC_ASSERT(std::abs(r[k] - direct(f, theta[k], z[k])) < 1e-12);
    RC_ASSERT(r[k] == f(theta[k], z[k]));
  }
  RC_ASSERT(std::abs(f(0, 10) - f(2 * pi, 10)) < 1e-12);  // the seam closes
}

TEST(RangeFunction, DerivativesAgainstFiniteDifferences) {
  std::mt19937_64 random(5);
  for (int p = 0; p <= 5; ++p) {
    for (int q = 0; q <= 5; ++q) {
      const RangeFunction f = test::random_function(random, test::random_space_u(random, p),
                                                    test::random_space_v(random, q), band(0, 60), 1);
      for (int k = 0; k < 20; ++k) {
        const double t = test::uniform(random, 0, 2 * pi), z = test::uniform(random, 1, 59);
        const double h = 1e-4, g = 1e-3;
        // Only where no knot lies within the difference's reach.
        const auto smooth = [&](const std::vector<double>& knots, double lo, double hi) {
          return std::none_of(knots.begin(), knots.end(), [&](double knot) { return knot > lo && knot < hi; });
        };
        const double v = f.base().arcs.v_of_theta(t), u = z / 60;
        if (!smooth(f.knots_v(), v - 2 * h, v + 2 * h) || std::abs(v - std::round(v)) < 2 * h) continue;
        if (!smooth(f.knots_u(), u - g / 30, u + g / 30)) continue;
        const RangeDerivatives d = f.derivatives(t, z);
        const double f0 = f(t, z);
        EXPECT_NEAR(d.r_mm, f0, 1e-13);
        EXPECT_NEAR(d.r_theta, (f(t + h, z) - f(t - h, z)) / (2 * h), 2e-4);
        EXPECT_NEAR(d.r_theta_theta, (f(t + h, z) - 2 * f0 + f(t - h, z)) / (h * h), 2e-2) << p << " " << q;
        EXPECT_NEAR(d.r_z, (f(t, z + g) - f(t, z - g)) / (2 * g), 2e-5);
        EXPECT_NEAR(d.r_z_z, (f(t, z + g) - 2 * f0 + f(t, z - g)) / (g * g), 1e-3);
        EXPECT_NEAR(d.r_theta_z, (f(t + h, z + g) - f(t + h, z - g) - f(t - h, z + g) + f(t - h, z - g)) / (4 * h * g),
                    1e-3);
      }
    }
  }
}

// F(v) = a + b v + c v^2 on one open arc: r(theta) through the printed (2.7), in extended precision.
TEST(RangeFunction, AngularDerivativesThroughTheSynchronisation) {
  BaseSurface base = band(0, 1);
  base.arcs = BaseArcs::open(0.3, 1.2);
  const double a = 20, b = 3, c = -2;
  const RangeFunction f(base, 0, 2, {0, 1}, {0, 0, 0, 1, 1, 1}, Eigen::RowVector3d(a, a + b / 2, a + b + c));
  const auto r = [&](long double theta) {
    const long double w = std::cos(static_cast<long double>(1.2) / 2), t = std::tan((theta - 0.3L) / 2);
    const long double eta = t / (std::sqrt(1 - w * w) + (1 - w) * t);
    return a + b * eta + c * eta * eta;
  };
  for (double theta = 0.35; theta < 1.45; theta += 0.1) {
    const long double h = 1e-4L, x = theta;
    const RangeDerivatives d = f.derivatives(theta, 0.5);
    EXPECT_NEAR(d.r_mm, static_cast<double>(r(x)), 1e-14);
    EXPECT_NEAR(d.r_theta, static_cast<double>((r(x + h) - r(x - h)) / (2 * h)), 1e-7);
    EXPECT_NEAR(d.r_theta_theta, static_cast<double>((r(x + h) - 2 * r(x) + r(x - h)) / (h * h)), 1e-7);
    EXPECT_EQ(d.r_z, 0);
  }
}

TEST(RangeFunction, CylinderHasItsCurvatureNormalAndDistance) {
  BaseSurface base = band(-5, 40);
  base.X_WB.linear() = Eigen::AngleAxisd(0.4, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  base.X_WB.translation() << 3, -8, 100;
  const RangeFunction f(base, 0, 0, {0, 1}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25));
  for (double t = 0; t < 6.3; t += 0.3) {
    const SurfacePoint p = f.surface_point(t, 12);
    const Eigen::Vector3d radial(std::cos(t), std::sin(t), 0);
    EXPECT_LT((p.p_W - base.X_WB * (25 * radial + Eigen::Vector3d(0, 0, 12))).norm(), 1e-13);
    EXPECT_LT((p.normal_W - base.X_WB.linear() * radial).norm(), 1e-15);
    EXPECT_NEAR(p.curvature_max, 1 / 25.0, 1e-16);
    EXPECT_NEAR(p.curvature_min, 0, 1e-16);
    const auto m = f.membership(base.X_WB * (26.5 * radial + Eigen::Vector3d(0, 0, 3)));
    EXPECT_TRUE(m.in_band);
    EXPECT_NEAR(m.ray_mm, 1.5, 1e-13);
    EXPECT_NEAR(m.signed_distance_mm, 1.5, 1e-13);
  }
  EXPECT_FALSE(f.membership(base.X_WB * Eigen::Vector3d(1, 1, 41)).in_band);
  EXPECT_FALSE(f.membership(base.X_WB * Eigen::Vector3d(1, 1, -6)).in_band);
  EXPECT_NEAR(f.membership(base.X_WB * Eigen::Vector3d(0, 0, 0)).ray_mm, -25, 1e-13);
}

TEST(RangeFunction, ConeDistanceIsRayTimesCosine) {
  const RangeFunction f = revolution({20, 30});  // r = 20 + z/2
  const double cosine = 1 / std::sqrt(1.25);
  const auto m = f.membership(Eigen::Vector3d(-43, 0, 30));
  EXPECT_NEAR(m.ray_mm, 43 - 35, 1e-13);
  EXPECT_NEAR(m.signed_distance_mm, 8 * cosine, 1e-13);
  EXPECT_NEAR(f.membership(Eigen::Vector3d(0, 30, 30)).signed_distance_mm, -5 * cosine, 1e-13);
}

TEST(RangeFunction, RevolutionHasItsClosedFormCurvatures) {
  const std::vector<double> c{30, 12, -40, 25};
  const RangeFunction f = revolution(c);
  for (double z = 0; z <= 60; z += 4) {
    const double x = z / 60;
    const double r = c[0] + x * (c[1] + x * (c[2] + x * c[3]));
    const double r1 = (c[1] + x * (2 * c[2] + x * 3 * c[3])) / 60, r2 = (2 * c[2] + x * 6 * c[3]) / 3600;
    const double parallel = 1 / (r * std::sqrt(1 + r1 * r1)), meridian = -r2 / std::pow(1 + r1 * r1, 1.5);
    for (double t = 0.1; t < 6.3; t += 0.7) {
      const SurfacePoint p = f.surface_point(t, z);
      EXPECT_NEAR(p.curvature_max, std::max(parallel, meridian), 1e-15);
      EXPECT_NEAR(p.curvature_min, std::min(parallel, meridian), 1e-15);
      const Eigen::Vector3d n = Eigen::Vector3d(std::cos(t), std::sin(t), -r1).normalized();
      EXPECT_LT((p.normal_W - n).norm(), 1e-14);
      EXPECT_NEAR(p.p_W.z(), z, 1e-13);
    }
  }
}

// A circle of radius 20 standing off-centre, r = d cos t + sqrt(R^2 - d^2 sin^2 t), approximated in a fine quintic
// space: its curvature is 1/R everywhere, the joints included.
TEST(RangeFunction, OffCentreCircleHasConstantCurvatureAcrossTheJoints) {
  const double R = 20, d = 6;
  const auto radius = [&](double t) { return d * std::cos(t) + std::sqrt(R * R - d * d * std::sin(t) * std::sin(t)); };
  const BaseArcs circle = BaseArcs::full_circle();
  const RangeSpace space = RangeSpace::over(5, circle, 16);
  const int n = 4000;
  Eigen::VectorXd v(n), r(n);
  for (int i = 0; i < n; ++i) v[i] = circle.v_of_theta((i + 0.5) / n * 2 * pi), r[i] = radius((i + 0.5) / n * 2 * pi);
  const Eigen::VectorXd free = test::collocation(space, v).householderQr().solve(r);
  const RangeFunction f(band(0, 10), 0, 5, {0, 1}, space.knots(), (space.extraction() * free).transpose());
  for (int i = 0; i < 400; ++i) {
    const double t = i / 400.0 * 2 * pi;
    const SurfacePoint p = f.surface_point(t, 5);
    EXPECT_NEAR(p.curvature_max, 1 / R, 2e-6) << t;
    EXPECT_NEAR(p.curvature_min, 0, 1e-15);
    EXPECT_LT((p.normal_W - Eigen::Vector3d((p.p_W.x() - d) / R, p.p_W.y() / R, 0)).norm(), 1e-6);
    // e_p cos(psi) is the distance to first order: psi reaches 17 degrees here, 4 % of a distance.
    const Eigen::Vector3d outside(p.p_W.x() + 0.01 * std::cos(t), p.p_W.y() + 0.01 * std::sin(t), 5);
    const double distance = std::hypot(outside.x() - d, outside.y()) - R;
    EXPECT_NEAR(f.membership(outside).signed_distance_mm, distance, 5e-6) << t;
  }
}

RC_GTEST_PROP(RangeFunction, ClippingKeepsTheFunction, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int p = std::uniform_int_distribution<int>(0, 5)(random), q = std::uniform_int_distribution<int>(0, 5)(random);
  const RangeFunction f =
      test::random_function(random, test::random_space_u(random, p), test::random_space_v(random, q), band(10, 90));
  double lo = test::uniform(random, 10, 90), hi = test::uniform(random, 10, 90);
  if (lo > hi) std::swap(lo, hi);
  if (random() % 4 == 0) lo = 10;
  if (random() % 4 == 0) hi = 90;
  if (p > 0 && random() % 4 == 0) lo = 10 + 80 * f.knots_u()[static_cast<std::size_t>(p)];  // exactly at a knot
  if (hi - lo < 0.1) return;
  const RangeFunction g = f.clipped(lo, hi);
  RC_ASSERT(g.base().band_start == lo);
  RC_ASSERT(g.base().band_end == hi);
  RC_ASSERT(g.degree_u() == p);
  RC_ASSERT(g.knots_u().front() == 0);
  RC_ASSERT(g.knots_u().back() == 1);
  for (int k = 0; k < 50; ++k) {
    const double t = test::uniform(random, 0, 7), z = test::uniform(random, lo, hi);
    RC_ASSERT(std::abs(g(t, z) - f(t, z)) < 2e-11);
  }
}

TEST(RangeFunction, ClippingAtAKnotMakesNoEmptyInterval) {
  std::mt19937_64 random(9);
  const RangeFunction f = test::random_function(random, RangeSpace::open(3, {0, 0.25, 0.5, 0.75, 1}),
                                                RangeSpace::constant({0, 4}), band(0, 100));
  const RangeFunction g = f.clipped(25, std::nextafter(75.0, 100.0));
  EXPECT_EQ(g.knots_u(), (std::vector<double>{0, 0, 0, 0, 0.5, 1, 1, 1, 1}));
  EXPECT_THROW(f.clipped(-1, 50), std::invalid_argument);
  EXPECT_THROW(f.clipped(50, 50), std::invalid_argument);
  EXPECT_THROW(f.clipped(50, 101), std::invalid_argument);
}

TEST(RangeFunction, InconsistentPartsAreRefused) {
  const std::vector<double> k3{0, 0, 0, 0, 1, 1, 1, 1};
  EXPECT_THROW(RangeFunction(band(0, 1), 3, 0, k3, {0, 4}, Eigen::MatrixXd::Ones(3, 1)), std::invalid_argument);
  EXPECT_THROW(RangeFunction(band(0, 1), 3, 0, k3, {0, 3}, Eigen::MatrixXd::Ones(4, 1)), std::invalid_argument);
  EXPECT_THROW(RangeFunction(band(1, 1), 3, 0, k3, {0, 4}, Eigen::MatrixXd::Ones(4, 1)), std::invalid_argument);
  EXPECT_THROW(RangeFunction(band(0, 1), 0, 0, {0, 0.5, 1}, {0, 4}, Eigen::MatrixXd::Ones(2, 1)),
               std::invalid_argument);
  EXPECT_THROW(RangeFunction()(0, 0), std::logic_error);
}

}  // namespace
}  // namespace celadon
