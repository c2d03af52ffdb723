// Quadrics against the thesis's printed example, closed forms of all 17 types and truths of noisy clouds.
#include "fitting/quadric.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>

#include "fitting/quadric_axes.h"
#include "fitting/quadric_type.h"
#include "tests/fitting/frame_tools.h"

namespace celadon {
namespace {

constexpr double kPi = std::numbers::pi;

const Quadric kPrinted = Quadric::from_coefficients(
    {0.808678, 0.574794, -0.045684, 0.015879, 0.002311, -0.163925, 49.971136, -43.447695, -9.216195, 1443.009728});

TEST(Quadric, PrintedExample_4_7_4_8) {
  // The printed determinant, 0.023747, is a hundredth of what (4.7) gives; the type hangs on its sign.
  EXPECT_GT(kPrinted.matrix().determinant(), 0);
  EXPECT_NEAR(kPrinted.matrix().determinant(), 2.3747, 0.01);
  const QuadricType type = classify(kPrinted, Eigen::Vector3d(-35, 38, -37), 30);
  EXPECT_EQ(type, QuadricType::hyperboloid_of_one_sheet);

  const QuadricAxes axes = quadric_axes(kPrinted, type, Eigen::Vector3d::Zero(), Eigen::Vector3d(-35, 38, 0));
  EXPECT_EQ(axes.reason, AxisReason::odd_sign);
  const QuadricFrame& frame = axes.frames[0];
  const Eigen::Vector3d miss = (frame.origin_mm - Eigen::Vector3d(-35.0288, 38.3524, -37.0531)).cwiseAbs();
  EXPECT_LT(miss.x(), 1e-4);
  EXPECT_LT(miss.y(), 1e-4);
  EXPECT_LT(miss.z(), 1e-3);
  EXPECT_LT((frame.axes.col(2) - Eigen::Vector3d(0.094667, -0.003027, 0.995504)).cwiseAbs().maxCoeff(), 1e-6);
  EXPECT_LT((frame.axes.col(0) - Eigen::Vector3d(0.995002, 0.032202, -0.094521)).cwiseAbs().maxCoeff(), 3e-5);
  EXPECT_LT((frame.axes.col(1) - Eigen::Vector3d(-0.031771, 0.999477, 0.006060)).cwiseAbs().maxCoeff(), 3e-5);
}

// Canonical form: squares, linear term of z or y, constant; ranks as in table 4.1.
struct Canonical {
  QuadricType type;
  std::array<double, 3> squares;
  int linear;  // 1: 2z, 2: 2y, 0: none
  double constant;
  int rank_u, rank;
};
const std::array<Canonical, 17> kCanonical = {{{QuadricType::real_ellipsoid, {1, 1, 1}, 0, -1, 3, 4},
                                               {QuadricType::imaginary_ellipsoid, {1, 1, 1}, 0, 1, 3, 4},
                                               {QuadricType::hyperboloid_of_one_sheet, {1, 1, -1}, 0, -1, 3, 4},
                                               {QuadricType::hyperboloid_of_two_sheets, {1, 1, -1}, 0, 1, 3, 4},
                                               {QuadricType::real_cone, {1, 1, -1}, 0, 0, 3, 3},
                                               {QuadricType::imaginary_cone, {1, 1, 1}, 0, 0, 3, 3},
                                               {QuadricType::elliptic_paraboloid, {1, 1, 0}, 1, 0, 2, 4},
                                               {QuadricType::hyperbolic_paraboloid, {1, -1, 0}, 1, 0, 2, 4},
                                               {QuadricType::real_elliptic_cylinder, {1, 1, 0}, 0, -1, 2, 3},
                                               {QuadricType::imaginary_elliptic_cylinder, {1, 1, 0}, 0, 1, 2, 3},
                                               {QuadricType::hyperbolic_cylinder, {1, -1, 0}, 0, -1, 2, 3},
                                               {QuadricType::real_intersecting_planes, {1, -1, 0}, 0, 0, 2, 2},
                                               {QuadricType::imaginary_intersecting_planes, {1, 1, 0}, 0, 0, 2, 2},
                                               {QuadricType::parabolic_cylinder, {1, 0, 0}, 2, 0, 1, 3},
                                               {QuadricType::real_parallel_planes, {1, 0, 0}, 0, -1, 1, 2},
                                               {QuadricType::imaginary_parallel_planes, {1, 0, 0}, 0, 1, 1, 2},
                                               {QuadricType::coincident_planes, {1, 0, 0}, 0, 0, 1, 1}}};

Eigen::Matrix4d matrix_of(const Canonical& form, const Eigen::Vector3d& half_axes) {
  Eigen::Matrix4d Q = Eigen::Matrix4d::Zero();
  for (int j = 0; j < 3; ++j) Q(j, j) = form.squares[static_cast<std::size_t>(j)] / (half_axes[j] * half_axes[j]);
  if (form.linear == 1) Q(2, 3) = Q(3, 2) = 1 / half_axes[2];
  if (form.linear == 2) Q(1, 3) = Q(3, 1) = 1 / half_axes[1];
  Q(3, 3) = form.constant;
  return Q;
}

// x = X y: Q becomes X^-T Q X^-1.
Quadric placed(const Eigen::Matrix4d& Q, const Eigen::Isometry3d& X) {
  const Eigen::Matrix4d back = X.inverse().matrix();
  const Eigen::Matrix4d P = back.transpose() * Q * back;
  return {P.topLeftCorner<3, 3>(), 2 * P.topRightCorner<3, 1>(), P(3, 3)};
}

TEST(QuadricType, CanonicalFormsHaveTheRanksOfTable_4_1) {
  for (const Canonical& form : kCanonical) {
    const Eigen::Matrix4d Q = matrix_of(form, {2, 1.5, 1});
    EXPECT_EQ(Eigen::FullPivLU<Eigen::Matrix3d>(Q.topLeftCorner<3, 3>()).rank(), form.rank_u) << to_string(form.type);
    EXPECT_EQ(Eigen::FullPivLU<Eigen::Matrix4d>(Q).rank(), form.rank) << to_string(form.type);
  }
}

RC_GTEST_PROP(QuadricType, AllSeventeenAreToldInAnyPlaceAndScale, (std::uint64_t seed)) {
  test::Random random(seed);
  const double size = std::pow(10.0, test::uniform(random, -2, 3)),
               factor = std::pow(10.0, test::uniform(random, -4, 4));
  for (const Canonical& form : kCanonical) {
    Eigen::Vector3d half_axes;
    for (int j = 0; j < 3; ++j) half_axes[j] = size * test::uniform(random, 0.4, 3);
    const Eigen::Isometry3d X = test::random_motion(random, 5 * size);
    Quadric q = placed(matrix_of(form, half_axes), X);
    const double sign = test::uniform(random, 0, 1) < 0.5 ? -factor : factor;
    q = {sign * q.Q_u, sign * q.v, sign * q.d};
    const Eigen::Vector3d beside = X * Eigen::Vector3d(test::uniform(random, -size, size), 0.3 * size, -0.2 * size);
    RC_LOG() << to_string(form.type) << " taken for " << to_string(classify(q, beside, size)) << "\n";
    RC_ASSERT(classify(q, beside, size) == form.type);
  }
}

TEST(QuadricType, APlaneIsNone) {
  Quadric plane;
  plane.v << 1, 2, 3;
  plane.d = -4;
  EXPECT_EQ(classify(plane, Eigen::Vector3d::Zero(), 10), QuadricType::none);
  EXPECT_THROW(classify(plane, Eigen::Vector3d::Zero(), 0), std::invalid_argument);
}

RC_GTEST_PROP(QuadricFit, RecoversExactQuadricsAnywhere, (std::uint64_t seed)) {
  test::Random random(seed);
  const double a = test::uniform(random, 10, 40), b = test::uniform(random, 10, 40), c = test::uniform(random, 10, 40);
  const Eigen::Isometry3d X = test::random_motion(random, 300);
  const bool sheet = test::uniform(random, 0, 1) < 0.5;
  Eigen::Matrix3Xd points =
      sheet ? test::around_axis(
                  random, 200, [&](double z) { return a * std::sqrt(1 + z * z / (c * c)); }, -c, 2 * c, 2 * kPi, b / a)
            : test::sphere_cap(random, 200, 1, 2.5);
  if (!sheet) points = Eigen::Vector3d(a, b, c).asDiagonal() * points;
  const Canonical& form = kCanonical[sheet ? 2 : 0];
  points = test::moved(X, points);
  const auto fit = fit_quadric(points);
  RC_ASSERT(fit.has_value());
  const Quadric truth = placed(matrix_of(form, {a, b, c}), X);
  const double scale =
      fit->quadric.Q_u.norm() / truth.Q_u.norm() * (fit->quadric.Q_u.trace() * truth.Q_u.trace() < 0 ? -1 : 1);
  RC_ASSERT((fit->quadric.Q_u - scale * truth.Q_u).norm() < 1e-9 * fit->quadric.Q_u.norm());
  RC_ASSERT(fit->residual_mm < 1e-10);
  RC_ASSERT(classify(*fit) == form.type);
  const QuadricAxes axes = quadric_axes(*fit);
  RC_ASSERT((axes.frames[0].origin_mm - X.translation()).norm() < 1e-6);
  // q is a distance: unit mean square of its gradient.
  double squares = 0;
  for (Eigen::Index k = 0; k < 200; ++k) squares += fit->quadric.gradient(points.col(k)).squaredNorm();
  RC_ASSERT(std::abs(squares / 200 - 1) < 1e-9);
}

TEST(QuadricFit, MovesAndScalesWithThePoints) {
  test::Random random(5);
  Eigen::Matrix3Xd points = Eigen::Vector3d(30, 25, 20).asDiagonal() * test::sphere_cap(random, 3000, 1, 1.4);
  test::add_noise(random, points, 0.3);
  const auto here = fit_quadric(points);
  const Eigen::Isometry3d X = test::random_motion(random, 100);
  const auto there = fit_quadric(7.3 * test::moved(X, points));
  ASSERT_TRUE(here && there);
  const Eigen::Vector3d o = quadric_axes(*here).frames[0].origin_mm, p = quadric_axes(*there).frames[0].origin_mm;
  EXPECT_LT((X * o - p / 7.3).norm(), 1e-9);
  EXPECT_NEAR(there->residual_mm, 7.3 * here->residual_mm, 1e-10);
}

TEST(QuadricFit, WeightsOfZeroLeaveOut) {
  test::Random random(6);
  Eigen::Matrix3Xd points = test::cylinder_sector(random, 400, 20, 30, 2 * kPi);
  test::add_noise(random, points, 0.1);
  std::vector<double> weights(400, 2.5);
  for (int k = 300; k < 400; ++k) {
    points.col(k).setConstant(1000 + k);
    weights[static_cast<std::size_t>(k)] = 0;
  }
  const auto weighted = fit_quadric(points, weights), fewer = fit_quadric(points.leftCols(300));
  ASSERT_TRUE(weighted && fewer);
  EXPECT_LT((weighted->quadric.Q_u - fewer->quadric.Q_u).norm(), 1e-10 * fewer->quadric.Q_u.norm());
  EXPECT_NEAR(weighted->residual_mm, fewer->residual_mm, 1e-10);
}

TEST(QuadricFit, PlanesLinesAndTooFewPointsAreRefused) {
  test::Random random(7);
  Eigen::Matrix3Xd points = test::cylinder_sector(random, 100, 20, 30, 2 * kPi);
  EXPECT_FALSE(fit_quadric(points.leftCols(9)));
  points.row(0).setConstant(3);
  EXPECT_FALSE(fit_quadric(points));
  points.row(1) = points.row(2);
  EXPECT_FALSE(fit_quadric(points));
  points.setOnes();
  EXPECT_FALSE(fit_quadric(points));
}

// 60 degree cap, R = 30, sigma 0.3: the median error is 0.41 mm with this normalisation and 7.0 with the thesis's.
TEST(QuadricFit, FindsTheCentreOfANoisyCap) {
  test::Random random(8);
  std::vector<double> errors;
  for (int trial = 0; trial < 61; ++trial) {
    Eigen::Matrix3Xd points = test::sphere_cap(random, 2000, 30, kPi / 3);
    test::add_noise(random, points, 0.3);
    const auto fit = fit_quadric(points);
    ASSERT_TRUE(fit);
    errors.push_back((-0.5 * fit->quadric.Q_u.inverse() * fit->quadric.v).norm());
  }
  std::nth_element(errors.begin(), errors.begin() + 30, errors.end());
  EXPECT_LT(errors[30], 0.6);
  EXPECT_GT(errors[30], 0.25);
}

// The standard deviations that tolerances hang on, against the spread of repeated fits.
TEST(QuadricFit, KnowsTheNoiseOfItsEigenvalues) {
  test::Random random(9);
  std::vector<Eigen::Vector3d> lambdas;
  Eigen::Vector3d promised = Eigen::Vector3d::Zero();
  const int trials = 300;
  const Eigen::Matrix3Xd clean = Eigen::Vector3d(30, 22, 14).asDiagonal() * test::sphere_cap(random, 800, 1, 2.2);
  for (int trial = 0; trial < trials; ++trial) {
    Eigen::Matrix3Xd points = clean;
    test::add_noise(random, points, 0.2);
    const auto fit = fit_quadric(points);
    ASSERT_TRUE(fit);
    const double sign = fit->normalised.Q_u.trace() < 0 ? -1 : 1;
    const Eigen::Vector3d l = fit->normalised.Q_u.selfadjointView<Eigen::Lower>().eigenvalues();
    lambdas.push_back(sign > 0 ? l : Eigen::Vector3d(-l.reverse()));
    const Eigen::Vector3d noise = eigenvalue_noise(*fit);
    promised += (sign > 0 ? noise : Eigen::Vector3d(noise.reverse())) / trials;
  }
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), square = Eigen::Vector3d::Zero();
  for (const auto& l : lambdas) mean += l / trials;
  for (const auto& l : lambdas) square += (l - mean).cwiseAbs2() / (trials - 1);
  for (int j = 0; j < 3; ++j) EXPECT_NEAR(promised[j] / std::sqrt(square[j]), 1, 0.3) << j;
}

// The thesis's rule on noisy cylinders is off by more than 45 degrees half of the time: they pass for ellipsoids, and
// the largest eigenvalue is then across the axis.
TEST(QuadricAxes, OfNoisyCylindersIsTheirAxis) {
  test::Random random(10);
  int thesis_off = 0;
  for (int trial = 0; trial < 60; ++trial) {
    Eigen::Matrix3Xd points = test::cylinder_sector(random, 2000, 30, 30, 2 * kPi);
    test::add_noise(random, points, 0.3);
    const Eigen::Isometry3d X = test::random_motion(random, 100);
    const auto fit = fit_quadric(test::moved(X, points));
    ASSERT_TRUE(fit);
    const QuadricAxes axes = quadric_axes(*fit);
    EXPECT_NE(axes.reason, AxisReason::comparable_gaps);
    EXPECT_LT(test::angle_deg(axes.frames[0].axes.col(2), X.linear().col(2)), 1);
    EXPECT_LT(test::off_axis(X, axes.frames[0].origin_mm), 0.5);
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(fit->quadric.Q_u);
    const bool same = solver.eigenvalues()[0] * solver.eigenvalues()[2] > 0;
    Eigen::Index largest = 0;
    solver.eigenvalues().cwiseAbs().maxCoeff(&largest);
    thesis_off += same && test::angle_deg(solver.eigenvectors().col(largest), X.linear().col(2)) > 45;
  }
  EXPECT_GT(thesis_off, 12);
}

TEST(QuadricAxes, OfACylinderSlidesToTheCentroid_E_4) {
  test::Random random(11);
  const Eigen::Isometry3d X = test::random_motion(random, 200);
  const Eigen::Matrix3Xd points = test::moved(X, test::around_axis(
                                                     random, 500, [](double) { return 12.0; }, 40, 90, 4));
  const auto fit = fit_quadric(points);
  ASSERT_TRUE(fit);
  const QuadricAxes axes = quadric_axes(*fit);
  EXPECT_EQ(axes.type, QuadricType::real_elliptic_cylinder);
  EXPECT_EQ(axes.reason, AxisReason::no_curvature);
  const Eigen::Vector3d local = X.inverse() * axes.frames[0].origin_mm;
  EXPECT_LT(local.head<2>().norm(), 1e-9);
  EXPECT_NEAR(local.z(), (X.inverse() * points.rowwise().mean().eval()).z(), 1e-9);
}

TEST(QuadricAxes, GapsDecideAndSpheresLeaveItOpen) {
  const auto reason = [](double a, double b, double c, const Eigen::Vector3d& along) {
    const Quadric q = placed(matrix_of(kCanonical[0], {a, b, c}), Eigen::Isometry3d::Identity());
    const QuadricAxes axes =
        quadric_axes(q, QuadricType::real_ellipsoid, Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero());
    if (axes.reason != AxisReason::comparable_gaps) {
      EXPECT_LT(test::angle_deg(axes.frames[0].axes.col(2), along), 1e-9);
    }
    for (const QuadricFrame& frame : axes.frames) {
      EXPECT_LT((frame.axes.transpose() * frame.axes - Eigen::Matrix3d::Identity()).norm(), 1e-14);
      EXPECT_NEAR(frame.axes.determinant(), 1, 1e-14);
    }
    return axes.reason;
  };
  EXPECT_EQ(reason(10, 11, 40, Eigen::Vector3d::UnitZ()), AxisReason::largest_gap);
  EXPECT_EQ(reason(40, 11, 42, Eigen::Vector3d::UnitY()), AxisReason::largest_gap);
  EXPECT_EQ(reason(10, 20, 40, Eigen::Vector3d::UnitZ()), AxisReason::comparable_gaps);
  EXPECT_EQ(reason(10, 10, 10, Eigen::Vector3d::UnitZ()), AxisReason::comparable_gaps);
}

}  // namespace
}  // namespace celadon
