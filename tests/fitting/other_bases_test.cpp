// Batches, distances, comparisons and sections over spheres and between rims that are not plane: against single points,
// closed forms and the exact surface.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <memory>
#include <numbers>
#include <random>
#include <vector>

#include "fitting/range_batch.h"
#include "fitting/section.h"
#include "fitting/signed_distance.h"
#include "fitting/surface_comparison.h"
#include "tests/fitting/simd_targets.h"
#include "tests/fitting/solid_tools.h"

namespace celadon {
namespace {

using std::numbers::pi;

RangeFunction over_sphere(std::mt19937_64& random, double start, double end, double spread = 2) {
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_start = start;
  base.band_end = end;
  if (random() % 2) base.X_WB = test::random_placement(random);
  const int p = std::uniform_int_distribution<int>(1, 5)(random), q = std::uniform_int_distribution<int>(0, 5)(random);
  std::vector<double> breaks = test::random_open_breaks(random);
  for (double& t : breaks) t = start + (end - start) * t;
  return test::random_function(random, RangeSpace::open(p, breaks), test::random_space_v(random, q), base, spread);
}

RangeFunction between_rims(std::mt19937_64& random) {
  const int q = std::uniform_int_distribution<int>(1, 5)(random);
  const RangeSpace around = test::random_space_v(random, q);
  Eigen::MatrixXd rims(2, around.extraction().rows());
  for (int row : {0, 1}) {
    const Eigen::VectorXd free = Eigen::VectorXd::NullaryExpr(
        around.free_count(), [&] { return (row == 0 ? -20 : 60) + test::uniform(random, -5, 5); });
    rims.row(row) = (around.extraction() * free).transpose();
  }
  BaseSurface base = test::band(-20, 60);
  base.heights = std::make_shared<const RangeFunction>(test::band(-20, 60), 1, q, std::vector<double>{0, 0, 1, 1},
                                                       around.knots(), rims);
  if (random() % 2) base.X_WB = test::random_placement(random);
  return test::random_body(random, base);
}

RangeFunction any(std::mt19937_64& random) {
  switch (random() % 3) {
    case 0:
      return between_rims(random);
    case 1:
      return over_sphere(random, 0, 2);
    default:
      return over_sphere(random, 0.3, 1.6);
  }
}

RC_GTEST_PROP(OtherBases, BatchesAreTheFunctionAndItsDerivatives, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const RangeFunction f = any(random);
  const BaseSurface& base = f.base();
  const RangeBatch batch(f);
  std::vector<double> theta, v, along;
  for (int k = 0; k < 50; ++k) {
    theta.push_back(test::uniform(random, 0, 2 * pi));
    v.push_back(base.arcs.v_of_theta(theta.back()));
    // Not near a pole, where curvatures of random functions are without bound.
    along.push_back(base.spherical() ? test::uniform(random, 0.35, 1.55)
                                     : test::uniform(random, base.band_start, base.band_end));
  }
  std::vector<double> r(50), r_t(50), r_z(50), r_tt(50), r_tz(50), r_zz(50);
  batch.evaluate(v.data(), along.data(), 50, {r.data(), r_t.data(), r_z.data(), r_tt.data(), r_tz.data(), r_zz.data()});
  std::vector<SurfacePoint> points(50);
  batch.surface_points(theta.data(), along.data(), 50, points.data());
  for (std::size_t k = 0; k < 50; ++k) {
    const RangeDerivatives d = f.derivatives(theta[k], along[k]);
    const auto near = [](double a, double b) { return std::abs(a - b) < 1e-8 * (1 + std::abs(b)); };
    RC_ASSERT(near(r[k], d.r_mm));
    RC_ASSERT(near(r_t[k], d.r_theta));
    RC_ASSERT(near(r_z[k], d.r_z));
    RC_ASSERT(near(r_tt[k], d.r_theta_theta));
    RC_ASSERT(near(r_tz[k], d.r_theta_z));
    RC_ASSERT(near(r_zz[k], d.r_z_z));
    const SurfacePoint p = f.surface_point(theta[k], along[k]);
    RC_ASSERT((points[k].p_W - p.p_W).norm() < 1e-10);
    RC_ASSERT((points[k].normal_W - p.normal_W).norm() < 1e-9);
    RC_ASSERT(near(points[k].curvature_max, p.curvature_max));
  }
}

TEST(OtherBases, PolesAreThoseOfTheFunction) {
  std::mt19937_64 random(4);
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_end = 2;
  const RangeFunction f =
      test::random_function(random, RangeSpace::open(3, {0, 1, 2}), RangeSpace::constant({0, 1, 2, 3, 4}), base);
  const double theta[] = {1, 2}, along[] = {0, 2};
  SurfacePoint points[2];
  RangeBatch(f).surface_points(theta, along, 2, points);
  for (int k : {0, 1}) {
    const SurfacePoint p = f.surface_point(theta[k], along[k]);
    EXPECT_LT((points[k].p_W - p.p_W).norm(), 1e-12);
    EXPECT_LT((points[k].normal_W - p.normal_W).norm(), 1e-9);
    EXPECT_NEAR(points[k].curvature_min, p.curvature_min, 1e-9);
  }
}

RC_GTEST_PROP(OtherBases, DistancesAreTheMembershipOfEachPoint, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const RangeFunction f = any(random);
  const SignedDistance distance(f);
  std::vector<double> x, y, z;
  for (int k = 0; k < 300; ++k) {
    const Eigen::Vector3d p =
        f.base().X_WB *
        Eigen::Vector3d(test::uniform(random, -40, 40), test::uniform(random, -40, 40), test::uniform(random, -40, 75));
    x.push_back(p.x()), y.push_back(p.y()), z.push_back(p.z());
  }
  std::vector<double> d(300), e(300), alone(300);
  distance.to_surface(x.data(), y.data(), z.data(), 300, d.data());
  distance.along_ray(x.data(), y.data(), z.data(), 300, e.data());
  for (std::size_t k = 0; k < 300; ++k) {
    const RangeFunction::Membership m = f.membership({x[k], y[k], z[k]});
    distance.to_surface(&x[k], &y[k], &z[k], 1, &alone[k]);
    RC_ASSERT(alone[k] == d[k] || (std::isnan(alone[k]) && std::isnan(d[k])));
    RC_ASSERT(m.in_band == !std::isnan(d[k]));
    if (!m.in_band) continue;
    RC_ASSERT(std::abs(e[k] - m.ray_mm) < 1e-10);
    RC_ASSERT(std::abs(d[k] - m.signed_distance_mm) < 1e-8);
  }
}

TEST(OtherBases, DistancesHaveTheSameBitsAtEverySimdLevel) {
  std::mt19937_64 random(2);
  for (const RangeFunction& f : {over_sphere(random, 0, 2), between_rims(random)}) {
    std::vector<double> x, y, z;
    for (int k = 0; k < 613; ++k) {
      const Eigen::Vector3d p = f.base().X_WB * Eigen::Vector3d(30 * Eigen::Vector3d::Random());
      x.push_back(p.x()), y.push_back(p.y()), z.push_back(p.z());
    }
    std::vector<double> first(613), again(613);
    SignedDistance(f).to_surface(x.data(), y.data(), z.data(), 613, first.data());
    test::at_every_simd_level([&] {
      SignedDistance(f).to_surface(x.data(), y.data(), z.data(), 613, again.data());
      for (std::size_t k = 0; k < 613; ++k)
        EXPECT_TRUE(first[k] == again[k] || (std::isnan(first[k]) && std::isnan(again[k]))) << k;
    });
  }
}

// On the axis, above both poles: the distance from a sphere that sits off its centre along the axis.
TEST(OtherBases, PointsOverThePoles) {
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_end = 2;
  const RangeFunction ball(base, 0, 0, {0, 2}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25));
  const double x[] = {0, 0, 1e-12}, y[] = {0, 0, 0}, z[] = {30, -26, 25.5};
  double d[3];
  SignedDistance(ball).to_surface(x, y, z, 3, d);
  EXPECT_NEAR(d[0], 5, 1e-12);
  EXPECT_NEAR(d[1], 1, 1e-12);
  EXPECT_NEAR(d[2], 0.5, 1e-12);
}

TEST(OtherBases, SpheresAreCompared) {
  std::mt19937_64 random(5);
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_end = 2;
  const RangeFunction ball(base, 0, 0, {0, 2}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25)),
      smaller(base, 0, 0, {0, 2}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 24.5));
  const auto shells = compare(ball, smaller);
  ASSERT_TRUE(shells);
  EXPECT_NEAR(shells->mean_mm, 0.5, 1e-13);
  EXPECT_NEAR(shells->rms_mm, 0.5, 1e-13);
  EXPECT_NEAR(shells->at_most_mm(), 0.5, 1e-12);

  const RangeFunction f = test::random_function(random, RangeSpace::open(3, {0, 0.4, 1, 2}),
                                                RangeSpace::over(3, BaseArcs::full_circle(), 2), base);
  const RangeFunction part = ball.clipped(0.25, 1.5);
  const auto c = compare(f, part);
  ASSERT_TRUE(c);
  EXPECT_EQ(c->start, 0.25);
  EXPECT_EQ(c->end, 1.5);
  // Midpoints over equal shares of the directions.
  const BaseArcs& meridian = BaseSurface::meridian();
  const double top = std::cos(meridian.theta_of_v(0.25)), bottom = std::cos(meridian.theta_of_v(1.5));
  double mean = 0, square = 0, most = -1e9;
  constexpr int kSteps = 500;
  for (int i = 0; i < kSteps; ++i)
    for (int j = 0; j < kSteps; ++j) {
      const double w = meridian.v_of_theta(std::acos(top + (bottom - top) * (i + 0.5) / kSteps));
      const double e = f(2 * pi * (j + 0.5) / kSteps, w) - 25;
      mean += e / kSteps / kSteps;
      square += e * e / kSteps / kSteps;
      most = std::max(most, e);
    }
  EXPECT_NEAR(c->mean_mm, mean, 1e-4);
  EXPECT_NEAR(c->rms_mm, std::sqrt(square), 1e-4);
  EXPECT_GE(c->largest.bound_mm, most);
  EXPECT_NEAR(c->largest.value_mm, most, 1e-2);
  EXPECT_NEAR(f(c->largest.theta_rad, c->largest.along) - 25, c->largest.value_mm, 1e-10);
  EXPECT_THROW(compare(ball, test::random_body(random, test::band(0, 2))), std::invalid_argument);
}

TEST(OtherBases, SectionsOfASphereAreCircles) {
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_end = 2;
  base.X_WB.translation() << 1, 2, 3;
  const RangeFunction ball(base, 0, 0, {0, 2}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25));
  for (const double z : {-20.0, 0.0, 7.0, 24.0}) {
    const Section s = section(ball, z);
    const double r = std::sqrt(625 - z * z);
    EXPECT_NEAR(s.area_mm2, pi * r * r, 1e-9) << z;
    EXPECT_NEAR(s.perimeter_mm, 2 * pi * r, 1e-9) << z;
    EXPECT_NEAR(s.largest_radius.value_mm, r, 1e-10) << z;
    EXPECT_LT((s.centroid_mm - Eigen::Vector3d(1, 2, 3 + z)).norm(), 1e-10) << z;
    EXPECT_LT(s.curve_error_mm, 1e-9) << z;
  }
  EXPECT_THROW(section(ball, 25.5), std::invalid_argument);
  EXPECT_THROW(section(ball, std::nan("")), std::invalid_argument);
}

// Of a lobed body: the curve lies on the surface, in the plane, and encloses the polygon through its points.
TEST(OtherBases, SectionsLieOnTheSurface) {
  std::mt19937_64 random(8);
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_start = 0.3;
  base.band_end = 1.7;
  const RangeFunction lobed = test::random_function(random, RangeSpace::open(3, {0.3, 1, 1.7}),
                                                    RangeSpace::over(3, BaseArcs::full_circle(), 2), base, 1);
  for (const RangeFunction& f : {lobed, between_rims(random)}) {
    const double z = f.base().spherical() ? 4 : 15;
    const Section s = section(f, z);
    EXPECT_LT(s.curve_error_mm, 1e-6);
    double doubled = 0;
    constexpr int kPoints = 4000;
    for (int k = 0; k < kPoints; ++k) {
      const Eigen::Vector3d a = s.point(4.0 * k / kPoints);
      const Eigen::Vector3d b = s.point(4.0 * ((k + 1) % kPoints) / kPoints);
      if (k % 10 == 0) {
        EXPECT_NEAR((f.base().X_WB.inverse() * a).z(), z, 1e-10);
        EXPECT_NEAR(f.membership(a).ray_mm, 0, 1e-6);
      }
      doubled += (a - s.centroid_mm).cross(b - s.centroid_mm).dot(f.base().X_WB.linear().col(2));
    }
    EXPECT_NEAR(s.area_mm2 / (doubled / 2), 1, 1e-5);
  }
}

}  // namespace
}  // namespace celadon
