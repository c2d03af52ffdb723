// Constraints against dense least squares with Lagrange multipliers, and against what they say.
#include "fitting/constraints.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <string>

#include "fitting/knot_selection.h"
#include "fitting/noise_correlation.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::kPi;

double largest_miss(const RangeFunction& f, double z, double radius) {
  double worst = 0;
  for (int k = 0; k < 257; ++k) worst = std::max(worst, std::abs(f(2 * kPi * k / 257, z) - radius));
  return worst;
}

// min |F - r|^2 with C x = d as one dense system (thesis, appendix C), C from the recursion of Cox and de Boor.
TEST(Constraints, AppendixC_AreTheDenseLagrangeMultipliers) {
  GridSpecification grid{0, 120, 16, 2, 3, 3, BaseArcs::full_circle(), BaseKind::cylinder};
  test::MemoryStream stream = test::scattered(test::freeform, 6000, 0.2);
  const MomentGrid sums = test::accumulate(stream, grid);
  const FitLadder ladder(sums, {0, 16}, 3, 3, JointContinuity::curvature);
  auto fit = solve_member(ladder, {1, 0}, {});
  ASSERT_TRUE(fit);
  const FitSpace space = fit->equations->space();

  std::vector<double> v, z, r;
  for (const Profile& p : stream.profiles)
    for (std::size_t k = 0; k < p.size(); ++k) {
      v.push_back(grid.arcs.v_of_theta(p.theta_rad[k]));
      z.push_back(p.z_mm[k]);
      r.push_back(p.r_mm[k]);
    }
  const Eigen::MatrixXd rows = test::design(space, v, z);
  const double at = 47.3, radius = 31, angle = 0.2, step = 1e-5;
  const Eigen::Index n = rows.cols(), nu = space.u.free_count(), nv = space.v.free_count();
  const auto along = [&](double height) {
    Eigen::RowVectorXd b(nu);
    for (Eigen::Index i = 0; i < nu; ++i) b(i) = test::bspline(space.u.knots(), static_cast<int>(i), 3, height);
    return b;
  };
  // The slope of a cubic by differences of third order, from inside.
  const Eigen::RowVectorXd slope =
      (11 * along(120) - 18 * along(120 - step) + 9 * along(120 - 2 * step) - 2 * along(120 - 3 * step)) / (6 * step);
  Eigen::MatrixXd C = Eigen::MatrixXd::Zero(2 * nv, n);
  Eigen::VectorXd d(2 * nv);
  for (Eigen::Index j = 0; j < nv; ++j) {
    C.row(2 * j).segment(j * nu, nu) = along(at);
    C.row(2 * j + 1).segment(j * nu, nu) = slope;
    d.segment(2 * j, 2) << radius, std::tan(angle);
  }
  Eigen::MatrixXd kkt = Eigen::MatrixXd::Zero(n + 2 * nv, n + 2 * nv);
  kkt.topLeftCorner(n, n) = rows.transpose() * rows;
  kkt.bottomLeftCorner(2 * nv, n) = C;
  kkt.topRightCorner(n, 2 * nv) = C.transpose();
  Eigen::VectorXd right(n + 2 * nv);
  right << rows.transpose() * Eigen::Map<const Eigen::VectorXd>(r.data(), static_cast<Eigen::Index>(r.size())), d;
  const Eigen::VectorXd expected = Eigen::FullPivLU<Eigen::MatrixXd>(kkt).solve(right).head(n);

  const Eigen::MatrixXd alone = fit->free;
  Constraints asked;
  asked.radii = {{at, radius}};
  asked.angle_end_rad = angle;
  Variation variation;
  const auto held = hold(asked, ladder, 0, 120, 0.04, {}, *fit, variation);
  ASSERT_TRUE(held) << held.error().message;
  const Eigen::Map<const Eigen::MatrixXd> wanted(expected.data(), nu, nv);
  EXPECT_LT((fit->free - wanted).cwiseAbs().maxCoeff(), 1e-6);
  EXPECT_GT((alone - wanted).cwiseAbs().maxCoeff(), 0.1);
  ASSERT_EQ(held->size(), 2u);
  EXPECT_NEAR(held->front().alone, (along(at) * alone).mean(), 1e-9);
  // Of the mean of 16 coefficients' values from 6000 samples: sigma over the root of those within the spline's reach.
  EXPECT_GT(held->front().alone_sd, 0.2 / std::sqrt(6000.0));
  EXPECT_LT(held->front().alone_sd, 0.2 / std::sqrt(6000.0 / 16));
}

// Whatever the model and the degree, F(theta, z) and its slope are what was asked for, to rounding.
RC_GTEST_PROP(Constraints, HoldToRounding, ()) {
  const int degree = *rc::gen::inRange(1, 6), kind = *rc::gen::inRange(0, 3);
  const test::Shape shape = [&](double t, double z) {
    return kind == 0 ? 30.0 : 30 + 0.05 * z + (kind == 2 ? 2 * std::cos(3 * t) * std::sin(kPi * z / 120) : 0);
  };
  test::MemoryStream stream = test::scan(
      shape, {.profiles = 60, .rows = 60, .sigma = 0.05, .seed = static_cast<unsigned>(*rc::gen::inRange(1, 1000))});
  RangeFitOptions options;
  options.degree_u = options.degree_v = degree;
  const double z = *rc::gen::inRange(0, 121);
  options.constraints.radii = {{z, shape(0, z) + 0.01 * *rc::gen::inRange(-20, 21)}};
  if (degree > 1 && *rc::gen::arbitrary<bool>()) options.constraints.angle_start_rad = 0.02;
  const auto fit = test::fit(stream, options);
  RC_ASSERT(fit);
  RC_ASSERT(largest_miss(fit->function, z, options.constraints.radii[0].radius_mm) < 1e-9);
  RC_ASSERT(fit->report.constraints.size() == (options.constraints.angle_start_rad ? 2u : 1u));
  if (options.constraints.angle_start_rad)
    for (int k = 0; k < 7; ++k) RC_ASSERT(std::abs(fit->function.derivatives(k, 0).r_z - std::tan(0.02)) < 1e-9);
}

// A cylinder whose radius is given stays one; two radii make it a revolution.
TEST(Constraints, AskForNoMoreThanTheyNeed) {
  const test::Shape shape = [](double, double) { return 25.0; };
  test::MemoryStream stream = test::scan(shape, {.sigma = 0.02});
  RangeFitOptions options;
  options.constraints.radii = {{60, 25.001}};
  auto fit = test::fit(stream, options);
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_EQ(fit->report.model, SurfaceModel::cylinder);
  EXPECT_EQ(fit->function(1, 2), 25.001);
  EXPECT_NEAR(fit->report.constraints.front().alone, 25, 4 * 0.02 / 200);
  EXPECT_NEAR(fit->report.constraints.front().alone_sd, 0.02 / 200, 0.02 / 800);
  options.constraints.radii = {{60, 25}, {90, 25}};
  fit = test::fit(stream, options);
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_EQ(fit->report.model, SurfaceModel::cylinder);
  options.constraints.radii = {{60, 25}, {90, 25.1}};
  fit = test::fit(stream, options);
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_EQ(fit->report.model, SurfaceModel::revolution);
  EXPECT_LT(largest_miss(fit->function, 90, 25.1), 1e-9);
  ASSERT_FALSE(fit->report.warnings.empty());
  EXPECT_NE(fit->report.warnings.back().find("contradict"), std::string::npos) << fit->report.warnings.back();
}

TEST(Constraints, ContradictionsAreNamed) {
  test::MemoryStream stream = test::scan([](double, double) { return 25.0; }, {.sigma = 0.02});
  const auto message = [&](std::vector<FixedRadius> radii, std::optional<double> angle = {},
                           BaseKind base = BaseKind::cylinder) {
    RangeFitOptions options;
    options.base = base;
    options.constraints = {std::move(radii), angle, {}};
    const auto grid = choose_grid(stream, {});
    const auto fit = fit_range(test::accumulate(stream, *grid), stream, options);
    return fit ? std::string("fitted") : fit.error().message;
  };
  EXPECT_EQ(message({{50, 20}, {50, 21}}),
            "the radius at z = 50 mm cannot be both 20 and 21 mm; leave one of them out");
  EXPECT_EQ(message({{50, 20}, {50, 20}}), "fitted");
  EXPECT_NE(message({{50, -3}}).find("-3 mm at z = 50 mm cannot be held"), std::string::npos);
  EXPECT_NE(message({{130, 20}}).find("the surface goes from z = 0 to 120 mm"), std::string::npos);
  EXPECT_NE(message({}, 1.56).find("within 89"), std::string::npos);
  EXPECT_NE(message({{50, 20}}, {}, BaseKind::sphere).find("over a cylinder only"), std::string::npos);
  std::vector<FixedRadius> many;
  for (int k = 0; k < 3000; ++k) many.push_back({0.04 * k, 20.0 + k % 2});
  EXPECT_NE(message(many).find("no surface with these samples holds all of"), std::string::npos);
}

}  // namespace
}  // namespace celadon
