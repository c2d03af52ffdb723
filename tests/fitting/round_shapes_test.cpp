// Distances, Jacobians, robust fits, line geometry, normals and neighbours against closed forms and plain search.
#include "fitting/round_shapes.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "fitting/line_geometry.h"
#include "fitting/nearest_points.h"
#include "fitting/robust_least_squares.h"
#include "fitting/surface_sample.h"
#include "tests/fitting/frame_tools.h"

namespace celadon {
namespace {

constexpr double kPi = std::numbers::pi;

template <class Shape>
double worst_jacobian_error(const Shape& shape, const Eigen::Matrix3Xd& points) {
  const Eigen::Index N = points.cols(), P = shape.unknowns();
  Eigen::VectorXd values(N), plus(N), minus(N);
  Eigen::MatrixXd J(N, P);
  shape.residuals(points, values, &J);
  double worst = 0;
  for (Eigen::Index j = 0; j < P; ++j) {
    const double h = 1e-5;
    shape.moved(h * Eigen::VectorXd::Unit(P, j)).residuals(points, plus, nullptr);
    shape.moved(-h * Eigen::VectorXd::Unit(P, j)).residuals(points, minus, nullptr);
    const Eigen::VectorXd differences = (plus - minus) / (2 * h);
    worst = std::max(worst, (differences - J.col(j)).cwiseAbs().maxCoeff() / (1 + differences.cwiseAbs().maxCoeff()));
  }
  return worst;
}

AxisFrame random_axis(test::Random& random) {
  const Eigen::Isometry3d X = test::random_motion(random, 5);
  return {X.linear(), X.translation()};
}

RC_GTEST_PROP(RoundShapes, JacobiansAreThoseOfTheResiduals, (std::uint64_t seed)) {
  test::Random random(seed);
  Eigen::Matrix3Xd points(3, 40);
  for (double& x : points.reshaped()) x = test::uniform(random, -3, 3);
  Sphere sphere{Eigen::Vector3d(4, -5, 6), 3};
  RC_ASSERT(worst_jacobian_error(sphere, points) < 1e-7);
  Cone cone{random_axis(random), 2, test::uniform(random, -1, 1), false};
  cone.axis.point_mm += 9 * cone.axis.axes.col(0);
  RC_ASSERT(worst_jacobian_error(cone, points) < 1e-7);
  cone.cylinder = true;
  RC_ASSERT(worst_jacobian_error(cone, points) < 1e-7);
  for (const bool elliptic : {false, true}) {
    MeridianSurface surface;
    surface.axis = random_axis(random);
    surface.axis.point_mm += 9 * surface.axis.axes.col(1);
    surface.half_band_mm = 6;
    surface.coefficients = Eigen::VectorXd::NullaryExpr(5, [&] { return test::uniform(random, -2, 2); });
    surface.coefficients[0] += 60;
    surface.elliptic = elliptic;
    if (elliptic) surface.a = test::uniform(random, -0.4, 0.4), surface.b = test::uniform(random, -0.4, 0.4);
    RC_ASSERT(worst_jacobian_error(surface, points) < 1e-6);
  }
}

TEST(RoundShapes, ResidualsAreDistances) {
  Eigen::Matrix3Xd x(3, 1);
  Eigen::VectorXd e(1);
  x << 3, 4, 12;
  Sphere{Eigen::Vector3d::Zero(), 10}.residuals(x, e, nullptr);
  EXPECT_NEAR(e[0], 3, 1e-14);
  Cone{{}, 4, 0, true}.residuals(x, e, nullptr);
  EXPECT_NEAR(e[0], 1, 1e-14);
  // The meridian r = 2 + h/... of slope 3/4 through (5, 12) is 0 away; a step of 1 along its normal (4, -3)/5 is 1
  // away.
  x << 5 + 0.8, 0, 12 - 0.6;
  Cone{{}, 5 - 9, 0.75, false}.residuals(x, e, nullptr);
  EXPECT_NEAR(e[0], 1, 1e-14);
  // A sphere as a meridian: r^2 = 100 - h^2, at its pole too; to first order.
  MeridianSurface ball;
  ball.half_band_mm = 10;
  ball.coefficients = Eigen::Vector3d(50, 0, -50);  // 100 (1 - s^2)
  x << 0, 0, 10.001;
  ball.residuals(x, e, nullptr);
  EXPECT_NEAR(e[0], 0.001, 1e-6);
  x << 0, 9.999, 0;
  ball.residuals(x, e, nullptr);
  EXPECT_NEAR(e[0], -0.001, 1e-6);
  // Half axes 8 and 4: X^2/64 + Y^2/16 = 1.
  MeridianSurface tube;
  tube.elliptic = true;
  tube.a = -0.6;
  tube.coefficients = Eigen::VectorXd::Constant(1, 25.6);
  x << 8.001, 0, 3;
  tube.residuals(x, e, nullptr);
  EXPECT_NEAR(e[0], 0.001, 1e-6);
  x << 0, 4.001, 3;
  tube.residuals(x, e, nullptr);
  EXPECT_NEAR(e[0], 0.001, 1e-6);
}

TEST(RobustLeastSquares, ComesBackToTheShapeThroughAThirdOfStrays) {
  test::Random random(1);
  Eigen::Matrix3Xd points = test::sphere_cap(random, 2000, 30, 1.5);
  test::add_noise(random, points, 0.05);
  for (int k = 0; k < 600; ++k) points.col(3 * k).z() += test::uniform(random, 3, 40);  // all on one side
  Sphere sphere{Eigen::Vector3d(1, -2, 4), 33};
  const RobustSolution solution = fit_robustly(sphere, points, Eigen::VectorXd::Ones(2000), 1e-9);
  EXPECT_TRUE(solution.converged);
  EXPECT_LT(sphere.centre_mm.norm(), 0.03);
  EXPECT_NEAR(sphere.radius_mm, 30, 0.03);
  EXPECT_NEAR(solution.inliers, 0.7, 0.02);
}

// For normal errors: the scale is their standard deviation, the covariance that of least squares over the biweight's
// efficiency of 95 %.
TEST(RobustLeastSquares, CovarianceIsThatOfNormalErrors) {
  test::Random random(2);
  const int N = 2000, trials = 200;
  Eigen::Vector4d mean_square = Eigen::Vector4d::Zero(), promised = Eigen::Vector4d::Zero();
  double scale = 0;
  for (int trial = 0; trial < trials; ++trial) {
    Eigen::Matrix3Xd points = test::sphere_cap(random, N, 30, 1.0);
    test::add_noise(random, points, 0.1);
    Sphere sphere{Eigen::Vector3d::Zero(), 30};
    const RobustSolution solution = fit_robustly(sphere, points, Eigen::VectorXd::Ones(N), 1e-9);
    Eigen::Vector4d error;
    error << sphere.centre_mm, sphere.radius_mm - 30;
    mean_square += error.cwiseAbs2() / trials;
    promised += solution.covariance.diagonal() / trials;
    scale += solution.scale / trials;
  }
  EXPECT_NEAR(scale, 0.1, 0.002);
  for (int j = 0; j < 4; ++j) EXPECT_NEAR(promised[j] / mean_square[j], 1, 0.3) << j;
}

TEST(RobustLeastSquares, SaysWhatIsNotDetermined) {
  // A whole sphere as a surface of revolution: any axis through the centre is one.
  test::Random random(3);
  Eigen::Matrix3Xd points = test::sphere_cap(random, 500, 10, kPi);
  MeridianSurface surface = meridian_through(points, Eigen::VectorXd::Ones(500), {}, 2);
  const RobustSolution solution = fit_robustly(surface, points, Eigen::VectorXd::Ones(500), 1e-9);
  EXPECT_EQ(solution.covariance.size(), 0);
}

// Normals of x = (r cos t, r sin t, p t + f(r)).
struct Lines {
  Eigen::Matrix3Xd points, normals;
};
template <class Height>
Lines helical(test::Random& random, int count, double pitch, const Height& f, double arc) {
  Lines lines{Eigen::Matrix3Xd(3, count), Eigen::Matrix3Xd(3, count)};
  for (int k = 0; k < count; ++k) {
    const double r = test::uniform(random, 10, 20), t = test::uniform(random, 0, arc), h = 1e-6;
    const double slope = (f(r + h) - f(r - h)) / (2 * h);
    lines.points.col(k) << r * std::cos(t), r * std::sin(t), pitch * t + f(r);
    const Eigen::Vector3d by_r(std::cos(t), std::sin(t), slope), by_t(-r * std::sin(t), r * std::cos(t), pitch);
    lines.normals.col(k) = by_r.cross(by_t).normalized();
  }
  return lines;
}

TEST(LineGeometry, FindsAxisAndPitchOfExactNormals) {
  test::Random random(4);
  const auto bowl = [](double r) { return 0.02 * r * r + 3 * std::sin(r / 3); };
  for (const double pitch : {0.0, 2.5}) {
    const Lines lines = helical(random, 400, pitch, bowl, 2);
    const Eigen::Isometry3d X = test::random_motion(random, 500);
    const auto axis = rotation_axis(test::moved(X, lines.points), X.linear() * lines.normals);
    ASSERT_TRUE(axis);
    EXPECT_LT(test::angle_deg(axis->direction, X.linear().col(2)), 1e-6);
    EXPECT_LT(test::off_axis(X, axis->point_mm), 1e-6);
    EXPECT_NEAR(std::abs(axis->pitch_mm), pitch, 1e-6);
    EXPECT_LT(axis->misfits_rad[0], 1e-6);
    EXPECT_GT(axis->misfits_rad[1], 1e-3);
  }
}

TEST(LineGeometry, AQuarterOfWildNormalsDoesNoHarm) {
  test::Random random(5);
  Lines lines = helical(
      random, 800, 0, [](double r) { return 0.05 * r * r; }, 2 * kPi);
  for (int k = 0; k < 800; ++k) {
    Eigen::Vector3d n = lines.normals.col(k);
    const double sigma = k % 4 == 0 ? 1 : 0.01;
    for (int j = 0; j < 3; ++j) n[j] += sigma * test::normal(random);
    lines.normals.col(k) = n.normalized() * (k % 2 ? 1 : -1);
  }
  const auto axis = rotation_axis(lines.points, lines.normals);
  ASSERT_TRUE(axis);
  EXPECT_LT(test::angle_deg(axis->direction, Eigen::Vector3d::UnitZ()), 0.3);
  EXPECT_LT(test::off_axis(Eigen::Isometry3d::Identity(), axis->point_mm), 0.1);
  EXPECT_FALSE(rotation_axis(lines.points.leftCols(5), lines.normals.leftCols(5)));
}

RC_GTEST_PROP(NearestPoints, AreThoseOfAPlainSearch, (std::uint64_t seed)) {
  test::Random random(seed);
  const int N = static_cast<int>(test::uniform(random, 1, 300)), count = static_cast<int>(test::uniform(random, 1, 40));
  Eigen::Matrix3Xd points(3, N);
  // Many ties.
  for (double& x : points.reshaped()) x = std::floor(test::uniform(random, 0, 6));
  const Eigen::Vector3d x(test::uniform(random, -1, 7), std::floor(test::uniform(random, -1, 7)), 2);
  std::vector<NearestPoints::Neighbour> all;
  for (int k = 0; k < N; ++k) all.push_back({(points.col(k) - x).squaredNorm(), k});
  std::sort(all.begin(), all.end());
  all.resize(static_cast<std::size_t>(std::min(N, count)));
  RC_ASSERT(NearestPoints(points).nearest(x, count) == all);
}

TEST(SurfaceSample, NeighbourhoodsGrowWithTheNoise) {
  test::Random random(6);
  int before = 0;
  for (const double sigma : {0.02, 0.2, 1.0}) {
    Eigen::Matrix3Xd points = test::sphere_cap(random, 20000, 30, kPi / 3);
    test::add_noise(random, points, sigma);
    const SurfaceSample sample = sample_surface(points);
    EXPECT_LE(sample.points.cols(), 6000);
    EXPECT_GE(sample.points.cols(), 3000);
    EXPECT_GE(sample.neighbours, before);
    before = sample.neighbours;
    // What the planes leave of the curvature is in it.
    EXPECT_GT(sample.noise_mm / sigma, 0.9) << sigma;
    EXPECT_LT(sample.noise_mm / sigma, 1.7) << sigma;
    double square = 0;
    for (Eigen::Index k = 0; k < sample.normals.cols(); ++k)
      square += std::pow(test::angle_deg(sample.normals.col(k), sample.middles.col(k)), 2);
    EXPECT_LT(std::sqrt(square / static_cast<double>(sample.normals.cols())), sigma < 0.5 ? 2 : 4) << sigma;
  }
  EXPECT_GE(before, 96);
}

TEST(SurfaceSample, StraysAreSeenByTheirDistance) {
  test::Random random(7);
  Eigen::Matrix3Xd points = test::cylinder_sector(random, 6000, 20, 30, 2 * kPi);
  Eigen::VectorXd truth = Eigen::VectorXd::Ones(6000);
  for (int k = 0; k < 600; ++k) {
    for (int j = 0; j < 3; ++j) points(j, 10 * k) = test::uniform(random, -60, 60);
    truth[10 * k] = 0;
  }
  const SurfaceSample sample = sample_surface(points);
  ASSERT_EQ(sample.points.cols(), 6000);
  EXPECT_GT(((1 - sample.weights.array()) * (1 - truth.array())).sum(), 450);
  EXPECT_EQ((sample.weights.array() * truth.array()).sum(), 5400);
  EXPECT_THROW(sample_surface(points.leftCols(11)), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
