// Curves through points of a plane: thesis chapter 2.

#include "fitting/polar_curve.h"

#include <gtest/gtest.h>

#include <functional>
#include <random>

#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::kPi;
using Radius = std::function<double(double theta)>;

Eigen::Matrix2Xd points_on(const Radius& r, int count, double sigma, double start = 0, double range = 2 * kPi) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> share(0, 1);
  Eigen::Matrix2Xd points(2, count);
  for (int k = 0; k < count; ++k) {
    const double theta = start + range * share(random), R = r(theta) + sigma * normal(random);
    points.col(k) << R * std::cos(theta), R * std::sin(theta);
  }
  return points;
}

double largest_miss(const NurbsCurve& curve, const Radius& r) {
  double worst = 0;
  for (int k = 0; k <= 1000; ++k) {
    const Eigen::Vector2d p = curve.evaluate(curve.knots.back() * k / 1000);
    worst = std::max(worst, std::abs(p.norm() - r(std::atan2(p.y(), p.x()))));
  }
  return worst;
}

double curvature(const CurveDerivatives& d) {
  return (d.C_v.x() * d.C_vv.y() - d.C_v.y() * d.C_vv.x()) / std::pow(d.C_v.norm(), 3);
}

double lobed_curve(double theta) {
  return 30 + 3 * std::cos(2 * theta + 0.3) + 1.5 * std::cos(5 * theta + 1) + 0.8 * std::sin(3 * theta);
}

TEST(PolarCurve, ACircleIsACircleOfDegree2) {
  for (const double sigma : {0.0, 0.02}) {
    const auto fit = fit_curve(points_on([](double) { return 25; }, 500, sigma), {.form_tolerance_mm = 0.005});
    ASSERT_TRUE(fit) << fit.error().message;
    EXPECT_TRUE(fit->circle) << fit->decided_by;
    EXPECT_EQ(fit->curve.degree, 2);
    EXPECT_EQ(fit->curve.control_points.cols(), 9);
    EXPECT_LT(largest_miss(fit->curve, [](double) { return 25; }), sigma == 0 ? 1e-10 : 0.004);
    EXPECT_EQ(fit->points, 500);
  }
}

TEST(PolarCurve, AnArcIsAnArc) {
  const BaseArcs arcs = BaseArcs::open(0.4, 3.5);
  const auto fit = fit_curve(points_on([](double) { return 25; }, 400, 0, 0.4, 3.5), {.arcs = arcs});
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_TRUE(fit->circle) << fit->decided_by;
  EXPECT_FALSE(fit->curve.closed);
  EXPECT_EQ(fit->curve.control_points.cols(), 7);  // three arcs, 3.5 rad are over 180 degrees (2.3)
  EXPECT_LT(largest_miss(fit->curve, [](double) { return 25; }), 1e-10);
  EXPECT_LT((fit->curve.evaluate(0) - 25 * Eigen::Vector2d(std::cos(0.4), std::sin(0.4))).norm(), 1e-10);
  EXPECT_LT((fit->curve.evaluate(3) - 25 * Eigen::Vector2d(std::cos(3.9), std::sin(3.9))).norm(), 1e-10);
}

TEST(PolarCurve, ErrorsFallWithTheFourthPower) {
  std::vector<double> errors;
  for (const int intervals : {8, 16, 32}) {
    const auto fit = fit_curve(points_on(lobed_curve, 20000, 0),
                               {.intervals_per_arc = intervals, .robust = false, .smoothing = false});
    ASSERT_TRUE(fit) << fit.error().message;
    EXPECT_FALSE(fit->circle);
    EXPECT_EQ(fit->curve.degree, 5);
    errors.push_back(largest_miss(fit->curve, lobed_curve));
  }
  EXPECT_GT(errors[0] / errors[1], 10);
  EXPECT_GT(errors[1] / errors[2], 12);
  EXPECT_LT(errors[2], 2e-5);
}

TEST(PolarCurve, ClosedCurvesAreSmoothAcrossEveryJoint) {
  const auto fit = fit_curve(points_on(lobed_curve, 3000, 0.02));
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_LT(largest_miss(fit->curve, lobed_curve), 0.02);
  EXPECT_NEAR(fit->noise_mm, 0.02, 0.002);
  const NurbsCurve& c = fit->curve;
  for (const double joint : {0.0, 1.0, 2.0, 3.0}) {
    const double before = joint == 0 ? 4 : joint;
    const auto left = c.derivatives(before - 1e-9), right = c.derivatives(joint + 1e-9);
    EXPECT_LT((left.C - right.C).norm(), 1e-6);
    EXPECT_NEAR(curvature(left), curvature(right), 1e-5) << joint;
  }
  EXPECT_EQ(c.control_points.col(0), c.control_points.col(c.control_points.cols() - 1));
}

// The product is F times the circle at every parameter (2.10).
TEST(PolarCurve, IsTheRangeTimesTheCircle_2_10) {
  const auto fit = fit_curve(points_on(lobed_curve, 2000, 0));
  ASSERT_TRUE(fit) << fit.error().message;
  const BaseArcs circle = BaseArcs::full_circle();
  for (int k = 0; k < 400; ++k) {
    const double v = 4 * (k + 0.3) / 400, theta = circle.theta_of_v(v);
    double r = 0;
    for (int j = 0; j < fit->coefficients.size(); ++j) r += fit->coefficients(j) * test::bspline(fit->knots, j, 3, v);
    EXPECT_LT((fit->curve.evaluate(v) - r * Eigen::Vector2d(std::cos(theta), std::sin(theta))).norm(), 1e-11);
  }
}

TEST(PolarCurve, OutliersStayOutside) {
  Eigen::Matrix2Xd points = points_on(lobed_curve, 4000, 0.02);
  for (int k = 0; k < 400; ++k) points.col(10 * k) *= 1.1;
  const auto fit = fit_curve(points);
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_NEAR(fit->rejected, 400, 10);
  EXPECT_LT(largest_miss(fit->curve, lobed_curve), 0.03);
}

TEST(PolarCurve, RefusesWithTheRemedy) {
  EXPECT_NE(fit_curve(Eigen::Matrix2Xd(2, 0)).error().message.find("no points"), std::string::npos);
  EXPECT_NE(fit_curve(Eigen::Matrix2Xd::Zero(2, 100)).error().message.find("on the axis"), std::string::npos);
  EXPECT_FALSE(fit_curve(points_on(lobed_curve, 5, 0)));
  EXPECT_FALSE(fit_curve(points_on(lobed_curve, 500, 0, 0, 1.0)));  // a sixth of the turn as a closed curve
  Eigen::Matrix2Xd none = points_on(lobed_curve, 50, 0);
  none.setConstant(std::numeric_limits<double>::quiet_NaN());
  EXPECT_FALSE(fit_curve(none));
}

}  // namespace
}  // namespace celadon
