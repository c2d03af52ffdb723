#include "fitting/base_arcs.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "fitting/bspline_basis.h"
#include "tests/fitting/spline_tools.h"

namespace celadon {
namespace {

using std::numbers::pi;
constexpr long double kPiL = std::numbers::pi_v<long double>;

// (2.7) as printed, in extended precision: the reference for every faster form.
long double printed_v(const BaseArcs& arcs, long double from_start, long double arc) {
  const long double j = std::min(std::floor(from_start / arc), static_cast<long double>(arcs.count() - 1));
  const long double t = std::tan((from_start - j * arc) / 2), w = std::cos(arc / 2);
  return j + t / (std::sqrt(1 - w * w) + (1 - w) * t);
}

// A point of the base curve from its homogeneous control points (2.3).
Eigen::Vector2d base_point(const BaseArcs& arcs, double v) {
  const auto knots = arcs.knots();
  const auto points = arcs.control_points();
  const int span = find_span(knots, 2, v);
  const auto N = basis_values(knots, 2, span, v);
  Eigen::RowVector3d h = Eigen::RowVector3d::Zero();
  for (int a = 0; a < 3; ++a) h += N[static_cast<std::size_t>(a)] * points.row(span - 2 + a);
  return h.head<2>().transpose() / h.z();
}

TEST(BaseArcs, CountOfArcsAndWeight_2_4) {
  EXPECT_EQ(BaseArcs::full_circle().count(), 4);
  EXPECT_EQ(BaseArcs::open(0, 2 * pi).count(), 4);
  EXPECT_EQ(BaseArcs::open(0, pi / 2).count(), 1);
  EXPECT_EQ(BaseArcs::open(0, pi / 2 + 1e-6).count(), 2);
  EXPECT_EQ(BaseArcs::open(1, 1.5 * pi).count(), 3);
  EXPECT_EQ(BaseArcs::open(0, 1e-3).count(), 1);
  EXPECT_DOUBLE_EQ(BaseArcs::full_circle().weight(), std::sqrt(0.5));
  EXPECT_DOUBLE_EQ(BaseArcs::open(0, pi).weight(), std::sqrt(0.5));
  EXPECT_NEAR(BaseArcs::open(0, pi / 3).weight(), std::sqrt(3.0) / 2, 1e-15);
  EXPECT_THROW(BaseArcs::open(0, 0), std::invalid_argument);
  EXPECT_THROW(BaseArcs::open(0, 7), std::invalid_argument);
  EXPECT_THROW(BaseArcs::open(NAN, 1), std::invalid_argument);
}

TEST(BaseArcs, ControlPointsMakeTheUnitCircle_2_3) {
  for (const BaseArcs& arcs : {BaseArcs::full_circle(), BaseArcs::open(0.7, 5.5), BaseArcs::open(-2, 0.01)}) {
    for (int k = 0; k <= 400; ++k) {
      const double v = arcs.count() * k / 400.0;
      const Eigen::Vector2d p = base_point(arcs, v);
      EXPECT_NEAR(p.norm(), 1, 4e-16);
      const double theta = arcs.theta_of_v(v);
      EXPECT_NEAR(p.x(), std::cos(theta), 2e-15) << v;  // (2.6)
      EXPECT_NEAR(p.y(), std::sin(theta), 2e-15) << v;
    }
  }
}

TEST(BaseArcs, ParameterAgreesWithThePrintedFormula_2_7) {
  std::mt19937_64 random(1);
  const BaseArcs circle = BaseArcs::full_circle();
  for (int k = 0; k < 20000; ++k) {
    const double theta = test::uniform(random, 0, 2 * pi);
    const auto truth = static_cast<double>(printed_v(circle, theta, kPiL / 2));
    EXPECT_NEAR(circle.v_of_theta(theta), truth, 1e-15 * std::max(1.0, truth)) << theta;
  }
  for (int k = 0; k < 2000; ++k) {
    const double range = test::uniform(random, 1e-3, 2 * pi), start = test::uniform(random, -3, 3);
    const BaseArcs arcs = BaseArcs::open(start, range);
    const double theta = start + test::uniform(random, 0, range);
    const auto truth = static_cast<double>(
        printed_v(arcs, std::min<long double>(theta - static_cast<long double>(start), range), arcs.arc_rad()));
    // theta itself carries its rounding of up to 1e-15 into the parameter of a small arc.
    EXPECT_NEAR(arcs.v_of_theta(theta), truth, 3e-15 / std::min(1.0, arcs.arc_rad())) << start << " " << range;
  }
}

TEST(BaseArcs, SmallAnglesKeepTheirRelativeAccuracy_2_7) {
  const BaseArcs circle = BaseArcs::full_circle();
  for (double theta = 1e-300; theta < 1; theta *= 7) {
    const auto truth = static_cast<double>(printed_v(circle, theta, kPiL / 2));
    EXPECT_NEAR(circle.v_of_theta(theta) / truth, 1, 1e-15) << theta;
  }
  // Small arcs, where the printed form loses digits: eta is nearly xi/arc, with a known cubic correction.
  const BaseArcs small = BaseArcs::open(0, 1e-5);
  for (double part = 0.05; part < 1; part += 0.05) {
    const double h = 1e-5, xi = part * h;
    // sin(a)/(sin(a) + sin(b)), a = xi/2, b = (h - xi)/2, to the order h^2
    const double a = xi / 2, b = (h - xi) / 2, correction = (1 - part) * (b * b - a * a) / 6;
    EXPECT_NEAR(small.v_of_theta(xi), part * (1 + correction), 4e-16) << part;
  }
}

TEST(BaseArcs, JointsAndSeam) {
  const BaseArcs circle = BaseArcs::full_circle();
  for (int j = -9; j <= 9; ++j) {
    const double v = circle.v_of_theta(j * pi / 2), expected = ((j % 4) + 4) % 4;
    EXPECT_TRUE(std::abs(v - expected) < 1e-14 || std::abs(v - expected - 4) < 1e-14 ||
                std::abs(v - expected + 4) < 1e-14)
        << j << " " << v;
  }
  EXPECT_EQ(circle.v_of_theta(0), 0);
  EXPECT_GE(circle.v_of_theta(-1e-18), 0);
  EXPECT_LE(circle.v_of_theta(-1e-18), 4);
  EXPECT_LE(circle.v_of_theta(std::nextafter(2 * pi, 7.0)), 4);
  EXPECT_TRUE(std::isnan(circle.v_of_theta(NAN)));
  EXPECT_TRUE(std::isnan(circle.v_of_theta(INFINITY)));
  EXPECT_NEAR(circle.v_of_theta(1e6 * 2 * pi + 1), circle.v_of_theta(1), 1e-9);
  EXPECT_EQ(circle.theta_of_v(4), 2 * pi);
  EXPECT_EQ(circle.theta_of_v(0), 0);
  EXPECT_EQ(circle.theta_of_v(2), pi);
}

// A few ulps on either side of each joint, where the arc of an angle is decided by its last bits.
TEST(BaseArcs, AnglesNextToTheJointsKeepTheirPlace) {
  const BaseArcs circle = BaseArcs::full_circle();
  for (int j = -20; j <= 40; ++j) {
    double theta = j * pi / 2;
    for (int k = 0; k < 6; ++k) theta = std::nextafter(theta, -100.0);
    for (int k = -6; k <= 6; ++k, theta = std::nextafter(theta, 100.0)) {
      const long double turned = std::fmod(static_cast<long double>(theta) + 40 * kPiL, 2 * kPiL);
      const auto truth = static_cast<double>(printed_v(circle, turned, kPiL / 2));
      const double v = circle.v_of_theta(theta);
      EXPECT_GE(v, 0);
      EXPECT_LE(v, 4);
      EXPECT_LT(std::abs(std::remainder(v - truth, 4.0)), 1e-14) << j << " " << k;  // 0 and 4 are one place
    }
  }
  // Open arcs: the joints and both ends.
  const BaseArcs arcs = BaseArcs::open(0.1, 4);
  for (int j = 0; j <= 3; ++j) {
    double theta = 0.1 + j * arcs.arc_rad();
    for (int k = 0; k < 6; ++k) theta = std::nextafter(theta, -100.0);
    for (int k = -6; k <= 6; ++k, theta = std::nextafter(theta, 100.0)) EXPECT_NEAR(arcs.v_of_theta(theta), j, 1e-14);
  }
}

TEST(BaseArcs, OpenArcsClampToTheNearerEnd) {
  const BaseArcs arcs = BaseArcs::open(-1, 2);  // two arcs around theta = 0
  EXPECT_EQ(arcs.v_of_theta(-1.2), 0);
  EXPECT_EQ(arcs.v_of_theta(1.2), 2);
  EXPECT_EQ(arcs.v_of_theta(3), 2);
  EXPECT_EQ(arcs.v_of_theta(-3), 0);
  EXPECT_EQ(arcs.v_of_theta(2 * pi - 3), 0);
  EXPECT_NEAR(arcs.v_of_theta(2 * pi), 1, 1e-15);
  const double x[] = {-1, -1, 0, std::cos(1.0), 0}, y[] = {0.1, -0.1, 1, std::sin(1.0), 0};
  double v[5], r[5];
  arcs.synchronise(x, y, 5, v, r);
  EXPECT_EQ(v[0], 2);
  EXPECT_EQ(v[1], 0);
  EXPECT_EQ(v[2], 2);
  EXPECT_NEAR(v[3], 2, 1e-15);
  EXPECT_EQ(v[4], 0);
}

TEST(BaseArcs, DerivativesOfTheSynchronisation) {
  const double w = std::sqrt(0.5);
  const BaseArcs circle = BaseArcs::full_circle();
  double d1 = 0, d2 = 0;
  for (int j = 0; j < 4; ++j) {
    // eta' = 1/(2 sqrt(1 - w^2)), eta'' = -1/(2 (1 + w)) at the start; theta_vv = -eta''/eta'^3
    circle.theta_derivatives(j, d1, d2);
    EXPECT_NEAR(1 / d1, 1 / (2 * std::sqrt(1 - w * w)), 1e-15);
    EXPECT_NEAR(-d2 / (d1 * d1 * d1), -1 / (2 * (1 + w)), 1e-15);
  }
  circle.theta_derivatives(4, d1, d2);
  EXPECT_NEAR(-d2 / (d1 * d1 * d1), 1 / (2 * (1 + w)), 1e-15);
  for (const BaseArcs& arcs : {circle, BaseArcs::open(0.3, 4), BaseArcs::open(0.3, 0.2)}) {
    for (double v = 0.05; v < arcs.count(); v += 0.1) {
      const double h = 1e-4;
      arcs.theta_derivatives(v, d1, d2);
      const double lo = arcs.theta_of_v(v - h), mid = arcs.theta_of_v(v), hi = arcs.theta_of_v(v + h);
      EXPECT_NEAR(d1, (hi - lo) / (2 * h), 1e-7);
      EXPECT_NEAR(d2, (hi - 2 * mid + lo) / (h * h), 1e-6);
    }
  }
}

// eta = y'/(sin(arc/2)(r + x') + (1 - w) y'): points against angles.
TEST(BaseArcs, PointsWithoutArctangentAgreeWithAngles) {
  std::mt19937_64 random(2);
  for (const BaseArcs& arcs : {BaseArcs::full_circle(), BaseArcs::open(0.4, 2 * pi), BaseArcs::open(-2.9, 3.1),
                               BaseArcs::open(2, 0.8), BaseArcs::open(0, 1.5 * pi)}) {
    std::vector<double> x, y, truth;
    for (int k = 0; k < 5003; ++k) {
      const double part = test::uniform(random, 0, 1);
      const double theta = arcs.start_rad() + part * arcs.arc_rad() * arcs.count();
      const double r = std::exp(test::uniform(random, -20, 20));
      x.push_back(r * std::cos(theta));
      y.push_back(r * std::sin(theta));
      const long double actual = std::atan2(static_cast<long double>(y.back()), static_cast<long double>(x.back()));
      long double from_start = std::fmod(actual - arcs.start_rad() + 4 * kPiL, 2 * kPiL);
      const long double arc = arcs.closed() ? kPiL / 2 : static_cast<long double>(arcs.arc_rad());
      // Rounding of x, y next to the ends of a range may put a point outside: it is clamped.
      const long double range = arc * arcs.count();
      if (from_start > range) from_start = from_start > kPiL + range / 2 ? 0 : range;
      truth.push_back(static_cast<double>(printed_v(arcs, from_start, arc)));
    }
    std::vector<double> v(x.size()), r(x.size());
    arcs.synchronise(x.data(), y.data(), x.size(), v.data(), r.data());
    for (std::size_t k = 0; k < x.size(); ++k) {
      EXPECT_NEAR(v[k], truth[k], 2e-15) << "point " << x[k] << ", " << y[k];
      const long double exact = std::hypot(static_cast<long double>(x[k]), static_cast<long double>(y[k]));
      EXPECT_NEAR(static_cast<double>(r[k] / exact), 1, 3e-16);
    }
  }
}

TEST(BaseArcs, PointsOnTheAxesAndBadPoints) {
  const BaseArcs circle = BaseArcs::full_circle();
  const double x[] = {1, 0, -1, 0, 0, -0.0, -2, NAN, 1}, y[] = {0, 1, 0, -1, 0, 3, -0.0, 1, -1e-30};
  double v[9], r[9];
  circle.synchronise(x, y, 9, v, r);
  EXPECT_EQ(v[0], 0);
  EXPECT_EQ(v[1], 1);
  EXPECT_EQ(v[2], 2);
  EXPECT_EQ(v[3], 3);
  EXPECT_EQ(v[4], 0);
  EXPECT_EQ(r[4], 0);
  EXPECT_EQ(v[5], 1);
  EXPECT_EQ(v[6], 2);
  EXPECT_TRUE(std::isnan(v[7]));
  EXPECT_TRUE(std::isnan(r[7]));
  EXPECT_GE(v[8], 0);
  EXPECT_LE(v[8], 4);
}

RC_GTEST_PROP(BaseArcs, RoundTripOfParameter, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const BaseArcs arcs = *rc::gen::arbitrary<bool>()
                            ? BaseArcs::full_circle()
                            : BaseArcs::open(test::uniform(random, -9, 9), test::uniform(random, 0.1, 6.2));
  const double v = test::uniform(random, 0, arcs.count());
  RC_ASSERT(std::abs(arcs.v_of_theta(arcs.theta_of_v(v)) - v) < 4e-15 / std::min(1.0, arcs.arc_rad()) * 4);
}

// Whatever the length and the alignment, a point's bits do not change.
RC_GTEST_PROP(BaseArcs, TailsAreBitIdentical, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const BaseArcs arcs = seed % 2 ? BaseArcs::full_circle() : BaseArcs::open(-1, 4);
  const auto n = static_cast<std::size_t>(std::uniform_int_distribution<int>(1, 40)(random));
  std::vector<double> x(n), y(n), theta(n), v(n), r(n), w(n), one_v(n), one_r(n), one_w(n);
  for (std::size_t k = 0; k < n; ++k) {
    x[k] = test::uniform(random, -50, 50), y[k] = test::uniform(random, -50, 50),
    theta[k] = test::uniform(random, -9, 9);
  }
  arcs.synchronise(x.data(), y.data(), n, v.data(), r.data());
  arcs.synchronise(theta.data(), n, w.data());
  for (std::size_t k = 0; k < n; ++k) {
    arcs.synchronise(&x[k], &y[k], 1, &one_v[k], &one_r[k]);
    one_w[k] = arcs.v_of_theta(theta[k]);
  }
  RC_ASSERT(v == one_v);
  RC_ASSERT(r == one_r);
  RC_ASSERT(w == one_w);
}

}  // namespace
}  // namespace celadon
