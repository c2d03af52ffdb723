// Fits of a part of the turn: the ends of the range are free of one another, what lies outside is left alone.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "fitting/covered_angles.h"
#include "fitting/range_fit.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::kPi;
using test::MemoryStream;

// Not periodic: what is fitted must not be pulled together at the ends.
double spiral(double theta, double z) {
  return 20 + 4 * theta + 0.02 * z + 0.8 * std::sin(2 * theta + 0.03 * z);
}

MemoryStream scattered_over(const test::Shape& shape, const BaseArcs& arcs, int n, double sigma, unsigned seed,
                            double beyond_rad = 0) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  const double range = arcs.count() * arcs.arc_rad();
  std::uniform_real_distribution<double> theta(arcs.start_rad() - beyond_rad, arcs.start_rad() + range + beyond_rad);
  std::uniform_real_distribution<double> height(0, 120);
  MemoryStream stream;
  for (int k = 0; k < n; ++k) {
    if (k % 1024 == 0) {
      stream.profiles.emplace_back();
      stream.profiles.back().order = ProfileOrder::scattered;
    }
    const double t = theta(random), z = height(random);
    test::push(stream.profiles.back(), shape(t, z) + sigma * normal(random), t, z);
  }
  return stream;
}

double largest_miss(const RangeFunction& f, const test::Shape& truth) {
  const BaseArcs& arcs = f.base().arcs;
  double largest = 0;
  for (int i = 0; i <= 200; ++i)
    for (int j = 0; j <= 60; ++j) {
      const double t = arcs.start_rad() + arcs.count() * arcs.arc_rad() * i / 200;
      const double z = f.base().band_start + (f.base().band_end - f.base().band_start) * j / 60;
      largest = std::max(largest, std::abs(f(t, z) - truth(t, z)));
    }
  return largest;
}

TEST(OpenRange, EndsAreIndependentOfEachOther) {
  for (const double range : {0.3, 1.5, 2.9, 4.4, 6.1}) {
    RangeFitOptions options;
    options.arcs = BaseArcs::open(0.1, range);
    MemoryStream stream = scattered_over(spiral, options.arcs, 60000, 0.01, 7);
    const auto fit = test::fit(stream, options);
    ASSERT_TRUE(fit.has_value()) << fit.error().message;
    EXPECT_FALSE(fit->surface.closed_v);
    EXPECT_LT(largest_miss(fit->function, spiral), 0.03) << "range " << range;
    EXPECT_NEAR(fit->report.noise_mm, 0.01, 0.001);
    EXPECT_EQ(fit->report.rejected, 0u);
  }
}

TEST(OpenRange, SurfaceIsTheFittedFunctionAndEndsWhereTheRangeEnds) {
  RangeFitOptions options;
  options.arcs = BaseArcs::open(2.5, 4);
  MemoryStream stream = scattered_over(spiral, options.arcs, 40000, 0.01, 8);
  const auto fit = test::fit(stream, options);
  ASSERT_TRUE(fit.has_value()) << fit.error().message;
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> share(0, 1);
  for (int k = 0; k < 2000; ++k) {
    const double v = k == 0 ? 0 : k == 1 ? options.arcs.count() : share(random) * options.arcs.count();
    const double u = share(random), theta = options.arcs.theta_of_v(v);
    const Eigen::Vector3d p = fit->surface.evaluate(u, v);
    const double r = fit->function(theta, p.z());
    EXPECT_NEAR(p.x(), r * std::cos(theta), 1e-11);
    EXPECT_NEAR(p.y(), r * std::sin(theta), 1e-11);
  }
  EXPECT_NEAR(std::remainder(options.arcs.theta_of_v(options.arcs.count()) - 6.5, 2 * kPi), 0, 1e-14);
}

TEST(OpenRange, ACylindersArcComesBackExactly) {
  RangeFitOptions options;
  options.arcs = BaseArcs::open(-0.7, 2);
  MemoryStream stream = scattered_over([](double, double) { return 25.0; }, options.arcs, 5000, 0, 9);
  const auto fit = test::fit(stream, options);
  ASSERT_TRUE(fit.has_value()) << fit.error().message;
  EXPECT_EQ(fit->report.model, SurfaceModel::cylinder) << fit->report.decided_by;
  EXPECT_EQ(fit->surface.degree_u, 1);
  EXPECT_EQ(fit->surface.degree_v, 2);
  for (int k = 0; k <= 50; ++k) {
    const Eigen::Vector3d p = fit->surface.evaluate(0.3, options.arcs.count() * k / 50.);
    EXPECT_NEAR(std::hypot(p.x(), p.y()), 25, 1e-9);
  }
}

// Whatever lies outside, the surface has the same bits.
TEST(OpenRange, WhatLiesOutsideIsCountedAndLeftAlone) {
  RangeFitOptions options;
  options.arcs = BaseArcs::open(1, 3);
  const auto torn = [](double t, double z) { return t < 1 || t > 4 ? 300 + 50 * std::sin(40 * t + z) : spiral(t, z); };
  MemoryStream calm = scattered_over(spiral, options.arcs, 40000, 0.01, 10, 0.5),
               wild = scattered_over(torn, options.arcs, 40000, 0.01, 10, 0.5);
  const auto a = test::fit(calm, options), b = test::fit(wild, options);
  ASSERT_TRUE(a.has_value() && b.has_value());
  EXPECT_TRUE(a->function.coefficients() == b->function.coefficients());
  EXPECT_EQ(a->report.rejected, b->report.rejected);
  EXPECT_NEAR(static_cast<double>(a->report.rejected), 10000, 300);  // a quarter of the angles
}

TEST(OpenRange, NothingInsideIsRefusedWithTheRange) {
  RangeFitOptions options;
  options.arcs = BaseArcs::open(0.5, 0.5);
  MemoryStream stream = scattered_over(spiral, BaseArcs::open(2, 1), 3000, 0.01, 11);
  const auto fit = test::fit(stream, options);
  ASSERT_FALSE(fit.has_value());
  EXPECT_NE(fit.error().message.find("none of the 3000 samples lies in the angular range from 28.6479 over 28.6479"),
            std::string::npos)
      << fit.error().message;
}

RC_GTEST_PROP(OpenRange, SamplesAreInsideOrOutsideHoweverTheyAreGiven, (unsigned seed)) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> angle(-7, 7), share(0, 1);
  const double start = angle(random), range = 0.01 + 6.2 * share(random);
  const BaseArcs arcs = BaseArcs::open(start, range);
  std::vector<double> theta{start, start + range, start + range - 2 * kPi, start + 2 * kPi};
  std::vector<bool> inside(4, true);
  for (int k = 0; k < 60; ++k) {
    const double t = start + 2 * kPi * share(random);
    theta.push_back(t + 2 * kPi * std::floor(4 * share(random) - 2));
    inside.push_back(t <= start + range);
  }
  std::vector<double> x, y, v(theta.size()), v_of_points(theta.size()), r(theta.size());
  for (const double t : theta) x.push_back(3 * std::cos(t)), y.push_back(3 * std::sin(t));
  arcs.place(theta.data(), theta.size(), v.data());
  arcs.place(x.data(), y.data(), x.size(), v_of_points.data(), r.data());
  for (std::size_t k = 0; k < theta.size(); ++k) {
    RC_ASSERT((v[k] >= 0) == inside[k]);
    RC_ASSERT(std::abs(v[k] - v_of_points[k]) < 1e-9 || (v[k] < 0 && v_of_points[k] < 0));
    RC_ASSERT(inside[k] || v[k] == BaseArcs::kOutside);
  }
}

TEST(OpenRange, SumsOfDifferentRangesAreNotMerged) {
  GridSpecification a{0, 10, 4, 4, 3, 3}, b = a;
  b.arcs = BaseArcs::open(0, 3);
  MomentGrid sums(a);
  EXPECT_THROW(sums.merge(MomentGrid(b)), std::invalid_argument);
}

TEST(CoveredAngles, AreOutsideTheWidestGap) {
  std::mt19937_64 random(3);
  const auto cloud = [&](int n, double from, double to, int strays) {
    Eigen::Matrix3Xd points(3, n + strays);
    for (int k = 0; k < n + strays; ++k) {
      const double t = k < n ? std::uniform_real_distribution<double>(from, to)(random)
                             : std::uniform_real_distribution<double>(0, 2 * std::numbers::pi)(random);
      points.col(k) << 30 * std::cos(t), 30 * std::sin(t), 1;
    }
    return points;
  };
  EXPECT_TRUE(covered_angles(cloud(20000, 0, 2 * std::numbers::pi, 0)).closed());
  EXPECT_TRUE(covered_angles(cloud(300, 0, 2 * std::numbers::pi, 0)).closed());
  EXPECT_TRUE(covered_angles(Eigen::Matrix3Xd(3, 0)).closed());
  for (const double from : {0.2, 2.5, 5.5})
    for (const double range : {0.5, 1.6, 4.0, 5.9})
      for (const int strays : {0, 100}) {
        const BaseArcs arcs = covered_angles(cloud(20000, from, from + range, strays));
        ASSERT_FALSE(arcs.closed()) << from << " " << range;
        EXPECT_NEAR(std::remainder(arcs.start_rad() - from, 2 * std::numbers::pi), 0, strays ? 0.02 : 0.005);
        EXPECT_NEAR(arcs.count() * arcs.arc_rad(), range, strays ? 0.04 : 0.01) << from << " " << range;
      }
}

}  // namespace
}  // namespace celadon
