// Batches against the B-spline form, and their bits against the same points alone, in another order, at other SIMD
// levels.
#include "fitting/range_batch.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>
#include <numeric>
#include <random>
#include <vector>

#include "fitting/knots.h"
#include "tests/fitting/simd_targets.h"
#include "tests/fitting/solid_tools.h"

namespace celadon {
namespace {

struct Derivatives {
  std::vector<double> r, r_theta, r_z, r_theta_theta, r_theta_z, r_z_z;
};
Derivatives evaluate(const RangeBatch& batch, const std::vector<double>& v, const std::vector<double>& z, int order) {
  Derivatives d;
  for (auto* array : {&d.r, &d.r_theta, &d.r_z, &d.r_theta_theta, &d.r_theta_z, &d.r_z_z}) array->resize(v.size());
  DerivativeArrays out{d.r.data()};
  if (order > 0) out.r_theta = d.r_theta.data(), out.r_z = d.r_z.data();
  if (order > 1) {
    out.r_theta_theta = d.r_theta_theta.data();
    out.r_theta_z = d.r_theta_z.data();
    out.r_z_z = d.r_z_z.data();
  }
  batch.evaluate(v.data(), z.data(), v.size(), out);
  return d;
}

// Runs along a line and points anywhere, some beyond the rims.
struct Points {
  std::vector<double> theta, v, z;
  Points(std::mt19937_64& random, const BaseSurface& base, int n) {
    for (int k = 0; k < n; ++k) {
      const bool run = k % 90 < 60;
      theta.push_back(run ? 1 + 0.3 * (k / 90) : test::uniform(random, 0, 2 * std::numbers::pi));
      z.push_back(run ? base.band_start + (k % 90) : test::uniform(random, base.band_start - 5, base.band_end + 5));
      v.push_back(base.arcs.v_of_theta(theta.back()));
    }
  }
};

TEST(RangeBatch, IsTheRangeFunctionAndItsDerivativesAtAllDegrees) {
  std::mt19937_64 random(1);
  for (int p = 0; p <= 5; ++p)
    for (int q = 0; q <= 5; ++q) {
      const RangeFunction f = test::random_function(random, test::random_space_u(random, p),
                                                    test::random_space_v(random, q), test::band(-7, 53));
      const Points at(random, f.base(), 403);
      const RangeBatch batch(f);
      const Derivatives d = evaluate(batch, at.v, at.z, 2), slopes = evaluate(batch, at.v, at.z, 1);
      EXPECT_EQ(evaluate(batch, at.v, at.z, 0).r, d.r);
      EXPECT_EQ(slopes.r, d.r);
      EXPECT_EQ(slopes.r_theta, d.r_theta);
      EXPECT_EQ(slopes.r_z, d.r_z);
      double steepest = 1;  // second derivatives of short intervals are large
      for (const double x : d.r_theta_theta) steepest = std::max(steepest, std::abs(x));
      for (std::size_t k = 0; k < at.v.size(); ++k) {
        const RangeDerivatives truth = f.derivatives(at.theta[k], at.z[k]);
        EXPECT_NEAR(d.r[k], truth.r_mm, 1e-12) << p << ", " << q;
        EXPECT_NEAR(d.r_theta[k], truth.r_theta, 1e-13 * steepest + 1e-11) << p << ", " << q;
        EXPECT_NEAR(d.r_z[k], truth.r_z, 1e-11) << p << ", " << q;
        EXPECT_NEAR(d.r_theta_theta[k], truth.r_theta_theta, 1e-11 * steepest) << p << ", " << q;
        EXPECT_NEAR(d.r_theta_z[k], truth.r_theta_z, 1e-12 * steepest + 1e-11) << p << ", " << q;
        EXPECT_NEAR(d.r_z_z[k], truth.r_z_z, 1e-10) << p << ", " << q;
      }
    }
}

TEST(RangeBatch, APointsBitsAreItsOwnAtEverySimdLevel) {
  std::mt19937_64 random(2);
  for (const auto& [p, q] : {std::pair{3, 3}, std::pair{2, 5}, std::pair{0, 1}, std::pair{5, 0}}) {
    const RangeFunction f = test::random_function(random, test::random_space_u(random, p),
                                                  test::random_space_v(random, q), test::band(-7, 53));
    const Points at(random, f.base(), 331);
    std::vector<std::size_t> order(at.v.size());
    std::iota(order.begin(), order.end(), 0u);
    std::shuffle(order.begin(), order.end(), random);
    std::vector<double> v, z;
    for (const std::size_t k : order) v.push_back(at.v[k]), z.push_back(at.z[k]);
    const RangeBatch batch(f);
    const Derivatives reference = evaluate(batch, at.v, at.z, 2);
    test::at_every_simd_level([&] {
      const Derivatives same = evaluate(batch, at.v, at.z, 2), shuffled = evaluate(batch, v, z, 2);
      EXPECT_EQ(same.r_theta_theta, reference.r_theta_theta);
      for (std::size_t k = 0; k < order.size(); ++k) {
        const std::size_t original = order[k];
        const Derivatives alone = evaluate(batch, {v[k]}, {z[k]}, 2);
        for (const auto member : {&Derivatives::r, &Derivatives::r_theta, &Derivatives::r_z,
                                  &Derivatives::r_theta_theta, &Derivatives::r_theta_z, &Derivatives::r_z_z}) {
          EXPECT_EQ((shuffled.*member)[k], (reference.*member)[original]);
          EXPECT_EQ((alone.*member)[0], (reference.*member)[original]);
        }
      }
    });
  }
}

TEST(RangeBatch, FindsTheIntervalOfVeryUnevenBreaks) {
  const std::vector<double> breaks{0, 1e-9, 2e-9, 0.001, 0.0011, 0.5, 0.5 + 1e-12, 0.75, 1 - 1e-7, 1};
  const IntervalTable table(breaks);
  std::vector<double> points{-1, 2, std::nan("")};
  for (const double t : breaks)
    for (const double x : {t, std::nextafter(t, -1), std::nextafter(t, 2), t + 1e-10, t - 1e-10, t + 0.01}) {
      points.push_back(x);
    }
  for (const double t : points) {
    const auto above = std::upper_bound(breaks.begin() + 1, breaks.end() - 1, std::isnan(t) ? 0 : t);
    EXPECT_EQ(table.locate(t), static_cast<std::size_t>(above - breaks.begin() - 1)) << t;
  }
}

TEST(RangeBatch, WhatIsNoNumberStaysByItself) {
  std::mt19937_64 random(3);
  const RangeFunction f = test::random_function(random, test::random_space_u(random, 3),
                                                test::random_space_v(random, 3), test::band(-7, 53));
  const double none = std::nan(""), far = std::numeric_limits<double>::infinity();
  const std::vector<double> v{0.3, none, 1.3, 2.2, 3.1, 0.1}, z{1, 2, none, 5, far, -far};
  const Derivatives d = evaluate(RangeBatch(f), v, z, 1);
  EXPECT_TRUE(std::isnan(d.r[1]));
  EXPECT_TRUE(std::isnan(d.r[2]));
  for (const std::size_t k : {0u, 3u, 4u, 5u}) {
    EXPECT_NEAR(d.r[k], f(f.base().arcs.theta_of_v(v[k]), std::clamp(z[k], -7.0, 53.0)), 1e-12);
  }
}

TEST(RangeBatch, SurfacePointsAreThoseOfTheRangeFunction) {
  std::mt19937_64 random(4);
  BaseSurface base = test::band(-7, 53);
  base.X_WB = test::random_placement(random);
  const RangeFunction f =
      test::random_function(random, RangeSpace::open(3, {0, 0.3, 1}), RangeSpace::over(3, base.arcs, 2), base);
  const Points at(random, base, 601);
  std::vector<SurfacePoint> points(at.theta.size());
  RangeBatch(f).surface_points(at.theta.data(), at.z.data(), points.size(), points.data());
  for (std::size_t k = 0; k < points.size(); ++k) {
    const SurfacePoint truth = f.surface_point(at.theta[k], at.z[k]);
    EXPECT_LT((points[k].p_W - truth.p_W).norm(), 1e-12);
    EXPECT_LT((points[k].normal_W - truth.normal_W).norm(), 1e-12);
    EXPECT_NEAR(points[k].curvature_max, truth.curvature_max, 1e-11);
    EXPECT_NEAR(points[k].curvature_min, truth.curvature_min, 1e-11);
  }
  // r = 30 - z/2: the cone's curvature is the cosine of its half angle over r, and none along its lines.
  const RangeFunction cone(test::band(0, 40), 1, 0, {0, 0, 1, 1}, {0, 4}, Eigen::Vector2d(30, 10));
  const double theta = 2, z = 12;
  SurfacePoint point;
  RangeBatch(cone).surface_points(&theta, &z, 1, &point);
  EXPECT_NEAR(point.curvature_max, 1 / std::sqrt(1.25) / 24, 1e-14);
  EXPECT_NEAR(point.curvature_min, 0, 1e-14);
}

}  // namespace
}  // namespace celadon
