// Differences of surfaces against closed forms, dense samples and the same surface written otherwise.
#include "fitting/surface_comparison.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <numbers>
#include <random>

#include "fitting/knots.h"
#include "tests/fitting/solid_tools.h"

namespace celadon {
namespace {

using std::numbers::pi;

// Cones: r = 30 - z/5 against r = 25 - z/10 over heights that overlap in part.
TEST(SurfaceComparison, OfCones) {
  const RangeFunction a(test::band(0, 50), 1, 0, {0, 0, 1, 1}, {0, 4}, Eigen::Vector2d(30, 20));
  const RangeFunction b(test::band(20, 80), 1, 0, {0, 0, 1, 1}, {0, 4}, Eigen::Vector2d(23, 17));
  const auto c = compare(a, b);
  ASSERT_TRUE(c);
  EXPECT_EQ(c->start, 20);
  EXPECT_EQ(c->end, 50);
  EXPECT_NEAR(c->largest.value_mm, 3, 1e-13);
  EXPECT_NEAR(c->largest.bound_mm, 3, 1e-13);
  EXPECT_NEAR(c->largest.along, 20, 1e-13);
  EXPECT_NEAR(c->smallest.value_mm, 0, 1e-13);
  EXPECT_NEAR(c->smallest.along, 50, 1e-13);
  EXPECT_NEAR(c->mean_mm, 1.5, 1e-13);
  EXPECT_NEAR(c->rms_mm, std::sqrt(3.0), 1e-13);
  EXPECT_NEAR(c->at_least_mm(), 3, 1e-13);
  const auto back = compare(b, a);
  EXPECT_NEAR(back->smallest.value_mm, -3, 1e-13);
  EXPECT_NEAR(back->at_most_mm(), 3, 1e-13);
}

// Meridians r = 20 + 12 t - 9 t^2 and 21 + t^3: the difference has its top where 12 - 18 t = 3 t^2.
TEST(SurfaceComparison, OfRevolutionsOfDifferentDegrees) {
  const auto c =
      compare(test::polynomial_revolution({20, 12, -9}, 60), test::polynomial_revolution({21, 0, 0, 1}, 60), 1e-12);
  const double t = std::sqrt(13.0) - 3, top = -1 + 12 * t - 9 * t * t - t * t * t;
  EXPECT_NEAR(c->largest.value_mm, top, 1e-12);
  EXPECT_LT(c->largest.bound_mm - c->largest.value_mm, 1e-11);
  EXPECT_NEAR(c->largest.along, 60 * t, 1e-3);
  EXPECT_NEAR(c->smallest.value_mm, -1, 1e-13);
  EXPECT_NEAR(c->mean_mm, -1 + 6 - 3 - 0.25, 1e-13);
  const auto square = [](double x) {  // the integral of (-1 + 12 x - 9 x^2 - x^3)^2
    const double k[] = {-1, 12, -9, -1};
    double sum = 0;
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j) sum += k[i] * k[j] * std::pow(x, i + j + 1) / (i + j + 1);
    return sum;
  };
  EXPECT_NEAR(c->rms_mm, std::sqrt(square(1)), 1e-13);
}

// However early the search stops, no point passes the bound.
TEST(SurfaceComparison, BoundsHoldAtAnyWidth) {
  const BezierPatches difference(test::polynomial_revolution({20, 12, -9}, 60),
                                 test::polynomial_revolution({21, 0, 0, 1}, 60));
  const double t = std::sqrt(13.0) - 3, top = -1 + 12 * t - 9 * t * t - t * t * t;
  for (const double width : {4.0, 1.0, 0.3, 0.1, 1e-2, 1e-4, 1e-8, 0.0}) {
    const Extremum e = extrema(difference, width).largest;
    EXPECT_LE(e.value_mm, top + 1e-13) << width;
    EXPECT_GE(e.bound_mm, top - 1e-13) << width;
    EXPECT_LE(e.bound_mm - e.value_mm, width + 1e-13) << width;
  }
}

RC_GTEST_PROP(SurfaceComparison, AgreesWithDenseSamples, (unsigned seed)) {
  std::mt19937_64 random(seed);
  BaseSurface lower = test::band(-20, 60), upper = test::band(test::uniform(random, -40, 20), 75);
  lower.X_WB = upper.X_WB = test::random_placement(random);
  const RangeFunction a = test::random_body(random, lower), b = test::random_body(random, upper);
  const auto c = compare(a, b);
  RC_ASSERT(c.has_value());
  const double lo = c->start, hi = c->end;
  RC_ASSERT(lo == std::max(-20.0, upper.band_start));
  RC_ASSERT(hi == 60);
  const int n = 240, m = 120;
  double sum = 0, square = 0, largest = -1e9, smallest = 1e9;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < m; ++j) {
      const double t = 2 * pi * (i + 0.5) / n, z = lo + (hi - lo) * (j + 0.5) / m, d = a(t, z) - b(t, z);
      sum += d, square += d * d;
      largest = std::max(largest, d);
      smallest = std::min(smallest, d);
    }
  RC_ASSERT(std::abs(c->mean_mm - sum / (n * m)) < 5e-3);
  RC_ASSERT(std::abs(c->rms_mm - std::sqrt(square / (n * m))) < 5e-3);
  const double width = 1e-6 * c->at_least_mm() + 1e-12;
  for (const auto& [e, sampled, sign] :
       {std::tuple{c->largest, largest, 1.0}, std::tuple{c->smallest, smallest, -1.0}}) {
    // A value that is taken, and a bound just beyond it that no sample passes.
    RC_ASSERT(std::abs(a(e.theta_rad, e.along) - b(e.theta_rad, e.along) - e.value_mm) < 1e-10);
    RC_ASSERT(sign * (e.bound_mm - sampled) > -1e-11);
    RC_ASSERT(sign * (e.bound_mm - e.value_mm) >= 0);
    RC_ASSERT(sign * (e.bound_mm - e.value_mm) <= width);
  }
}

// The same function over more knots, or clipped: no difference but rounding.
RC_GTEST_PROP(SurfaceComparison, ASurfaceIsItself, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int p = std::uniform_int_distribution<int>(1, 5)(random), q = std::uniform_int_distribution<int>(1, 5)(random);
  const RangeFunction f = test::random_function(random, test::random_space_u(random, p),
                                                test::random_space_v(random, q), test::band(-20, 60));
  const std::vector<double> more{test::uniform(random, 0.01, 0.99), test::uniform(random, 0.01, 0.99)};
  const Refinement refined = insert_knots(f.knots_u(), p, more);
  const RangeFunction same(f.base(), p, q, refined.knots, f.knots_v(), refined.map * f.coefficients());
  const auto c = compare(f, same);
  RC_ASSERT(c->at_most_mm() < 1e-12);
  RC_ASSERT(c->rms_mm < 1e-13);
  const double lo = test::uniform(random, -20, 10), hi = test::uniform(random, 20, 60);
  const auto cut = compare(f.clipped(lo, hi), f);
  RC_ASSERT(cut->start == lo);
  RC_ASSERT(cut->end == hi);
  RC_ASSERT(cut->at_most_mm() < 2e-11);
}

// What lies between a and c is at most what lies between a and b and b and c; one dent is found wherever it is.
RC_GTEST_PROP(SurfaceComparison, FindsOneDent, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const RangeSpace u = RangeSpace::open(3, {0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1});
  const RangeSpace v = RangeSpace::over(3, BaseArcs::full_circle(), 8);
  const RangeFunction f = test::random_function(random, u, v, test::band(0, 100));
  Eigen::MatrixXd c = f.coefficients();
  const auto i = std::uniform_int_distribution<Eigen::Index>(3, c.rows() - 4)(random);
  c(i, 13) -= 1e-3;
  const RangeFunction dented(f.base(), 3, 3, f.knots_u(), f.knots_v(), c);
  const auto found = compare(dented, f, 1e-9);
  // The cubic function of a uniform knot vector has 2/3 at its middle; around, the knots are uniform there too.
  RC_ASSERT(std::abs(found->smallest.value_mm + 1e-3 * 4 / 9) < 1e-12);
  RC_ASSERT(std::abs(found->smallest.along - 10 * static_cast<double>(i - 1)) < 0.01);
  RC_ASSERT(std::abs(found->largest.bound_mm) < 1e-13);
}

TEST(SurfaceComparison, SignedDifferencesOverAGrid) {
  const RangeFunction a(test::band(0, 50), 1, 0, {0, 0, 1, 1}, {0, 4}, Eigen::Vector2d(30, 20));
  const RangeFunction b(test::band(20, 80), 1, 0, {0, 0, 1, 1}, {0, 4}, Eigen::Vector2d(23, 17));
  const std::vector<double> theta{0, 1, 5}, z{10, 20, 40, 50, 51};
  const Eigen::MatrixXd d = signed_differences(a, b, theta, z);
  ASSERT_EQ(d.rows(), 5);
  ASSERT_EQ(d.cols(), 3);
  for (int j = 0; j < 3; ++j) {
    EXPECT_TRUE(std::isnan(d(0, j)));
    EXPECT_NEAR(d(1, j), 3, 1e-13);
    EXPECT_NEAR(d(2, j), 1, 1e-13);
    EXPECT_NEAR(d(3, j), 0, 1e-13);
    EXPECT_TRUE(std::isnan(d(4, j)));
  }
}

TEST(SurfaceComparison, DifferentFramesAndBands) {
  const RangeFunction a = test::polynomial_revolution({20, 3}, 50);
  BaseSurface moved = a.base();
  moved.X_WB.translation().x() = 1e-9;
  EXPECT_THROW(compare(a, {moved, 0, 0, {0, 1}, {0, 4}, Eigen::MatrixXd::Ones(1, 1)}), std::invalid_argument);
  BaseSurface open = a.base();
  open.arcs = BaseArcs::open(0, 1);
  EXPECT_THROW(compare(a, {open, 0, 0, {0, 1}, {0, 1}, Eigen::MatrixXd::Ones(1, 1)}), std::invalid_argument);
  EXPECT_THROW(compare(a, a, 0), std::invalid_argument);
  EXPECT_FALSE(compare(a, {test::band(50, 60), 0, 0, {0, 1}, {0, 4}, Eigen::MatrixXd::Ones(1, 1)}).has_value());
}

}  // namespace
}  // namespace celadon
