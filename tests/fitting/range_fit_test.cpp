#include "fitting/range_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <limits>

#include "fitting/fit_ladder.h"
#include "fitting/knot_selection.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::fit;
using test::freeform;
using test::kPi;
using test::MemoryStream;
using test::miss;
using test::scan;
using testing::HasSubstr;

double cylinder(double, double) {
  return 30;
}
double cubic_profile(double, double z) {
  const double x = z / 120;
  return 30 + 5 * x - 20 * x * x + 12 * x * x * x;
}
double wavy_profile(double, double z) {
  return 30 + 6 * std::sin(2 * kPi * z / 120);
}

TEST(RangeFit, NoiseFreeCylinderComesBackExactly) {
  MemoryStream stream = scan(cylinder, {});
  const auto f = fit(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_EQ(f->report.model, SurfaceModel::cylinder);
  EXPECT_EQ(f->surface.degree_u, 1);
  EXPECT_EQ(f->surface.degree_v, 2);
  EXPECT_EQ(f->report.control_points_u, 2);
  EXPECT_EQ(f->report.control_points_v, 9);
  EXPECT_LT(miss(f->function, cylinder).max, 1e-9);
  EXPECT_LT(f->report.residual_mm.max, 1e-9);
  EXPECT_DOUBLE_EQ(f->report.z_start_mm, 0);
  EXPECT_DOUBLE_EQ(f->report.z_end_mm, 120);
  EXPECT_DOUBLE_EQ(f->report.coverage, 1);
  EXPECT_EQ(f->report.rejected, 0u);
  EXPECT_TRUE(f->report.warnings.empty());
  EXPECT_LE(stream.passes, 3);
}

TEST(RangeFit, NoiseFreeRevolutionComesBackExactly) {
  MemoryStream stream = scan(cubic_profile, {});
  const auto f = fit(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_EQ(f->report.model, SurfaceModel::revolution);
  EXPECT_EQ(f->surface.degree_u, 3);
  EXPECT_EQ(f->surface.degree_v, 2);
  EXPECT_LT(miss(f->function, cubic_profile).max, 1e-9);
  EXPECT_LT(f->report.residual_mm.max, 1e-9);
}

// The surface's own points, not F: on the truth, and right round.
TEST(RangeFit, ExportedSurfaceIsTheFittedOne) {
  MemoryStream stream = scan(cubic_profile, {});
  const auto f = fit(stream);
  ASSERT_TRUE(f);
  for (int i = 0; i <= 10; ++i)
    for (int j = 0; j < 40; ++j) {
      const Eigen::Vector3d p = f->surface.evaluate(i / 10.0, j / 10.0);
      EXPECT_NEAR(std::hypot(p.x(), p.y()), cubic_profile(0, p.z()), 1e-9);
    }
}

TEST(RangeFit, NoisyFreeformIsGeneralAndNearTheTruth) {
  for (const double correlation : {0.0, 0.5}) {
    MemoryStream stream = scan(freeform, {.profiles = 300, .rows = 300, .sigma = 0.02, .correlation = correlation});
    const auto f = fit(stream);
    ASSERT_TRUE(f) << f.error().message;
    EXPECT_EQ(f->report.model, SurfaceModel::general);
    EXPECT_EQ(f->surface.degree_u, 3);
    EXPECT_EQ(f->surface.degree_v, 5);
    EXPECT_NEAR(f->report.noise_mm, 0.02, 0.003);
    EXPECT_NEAR(f->report.kappa, correlation > 0 ? 3 : 1, 1.2);
    EXPECT_NEAR(f->report.residual_mm.rms, 0.02, 0.001);
    EXPECT_NEAR(f->report.residual_mm.p95, 1.96 * 0.02, 0.002);
    EXPECT_LT(f->report.geometric_mm.rms, f->report.residual_mm.rms);
    EXPECT_LT(miss(f->function, freeform).rms, 0.0045);
    EXPECT_THAT(f->report.decided_by, HasSubstr("general"));
    EXPECT_THAT(f->report.decided_by, HasSubstr("without a form tolerance the samples alone say general"));
    EXPECT_THAT(f->report.stopped_by, HasSubstr("Cp"));
  }
}

// The rule of the accuracy bar on small scans: at most 1.15 times the best unsmoothed member of the ladder.
TEST(RangeFit, IsAsGoodAsTheBestMemberOfTheLadder) {
  for (const double correlation : {0.0, 0.5})
    for (const int n : {100, 250}) {
      MemoryStream stream =
          scan(freeform, {.profiles = n, .rows = n, .sigma = 0.02, .correlation = correlation, .seed = 7});
      const auto f = fit(stream);
      ASSERT_TRUE(f) << f.error().message;
      const auto grid = choose_grid(stream, {});
      const MomentGrid sums = test::accumulate(stream, *grid);
      const FitLadder ladder(sums, {0, sums.z_cells()}, 3, 3, JointContinuity::curvature);
      double best = 1e300;
      for (int u = 0; u < ladder.levels_u(); ++u)
        for (int v = 0; v < ladder.levels_v(); ++v)
          if (const auto member = solve_member(ladder, {u, v}, {}))
            best = std::min(best, miss(range_function(*member->equations, member->free), freeform).rms);
      EXPECT_LE(miss(f->function, freeform).rms, 1.15 * best) << n << " correlation " << correlation;
    }
}

TEST(RangeFit, AllDegreesWork) {
  for (int p = 1; p <= 5; ++p)
    for (int q = 1; q <= 5; ++q) {
      MemoryStream stream = scan(freeform, {.profiles = 120, .rows = 120, .sigma = 0.02});
      RangeFitOptions options;
      options.degree_u = p;
      options.degree_v = q;
      const auto f = fit(stream, options);
      ASSERT_TRUE(f) << p << ", " << q << ": " << f.error().message;
      EXPECT_EQ(f->surface.degree_u, p);
      EXPECT_EQ(f->surface.degree_v, q + 2);
      EXPECT_LT(miss(f->function, freeform).rms, p == 1 || q == 1 ? 0.06 : 0.015) << p << ", " << q;
    }
}

TEST(RangeFit, GivenModelsIntervalsAndContinuityAreKept) {
  MemoryStream stream = scan(freeform, {.profiles = 120, .rows = 120, .sigma = 0.02});
  RangeFitOptions options;
  options.model = SurfaceModel::revolution;
  auto f = fit(stream, options);
  ASSERT_TRUE(f);
  EXPECT_EQ(f->report.model, SurfaceModel::revolution);
  EXPECT_EQ(f->surface.degree_v, 2);
  EXPECT_THAT(f->report.decided_by, HasSubstr("as given"));
  EXPECT_THAT(f->report.decided_by, HasSubstr("general"));

  options = {};
  options.z_intervals = 8;
  options.intervals_per_arc = 4;
  options.smoothing = false;
  options.continuity = JointContinuity::thesis;
  f = fit(stream, options);
  ASSERT_TRUE(f);
  EXPECT_EQ(f->function.coefficients().rows(), 11);
  EXPECT_THAT(f->report.stopped_by, HasSubstr("as given"));
  const double thesis_jump = std::abs(f->function.derivatives(kPi / 2 - 1e-7, 60).r_theta_theta -
                                      f->function.derivatives(kPi / 2 + 1e-7, 60).r_theta_theta);
  options.continuity = JointContinuity::curvature;
  f = fit(stream, options);
  ASSERT_TRUE(f);
  const double jump = std::abs(f->function.derivatives(kPi / 2 - 1e-7, 60).r_theta_theta -
                               f->function.derivatives(kPi / 2 + 1e-7, 60).r_theta_theta);
  EXPECT_LT(jump, 1e-4);
  EXPECT_GT(thesis_jump, 100 * jump);
}

TEST(RangeFit, ToleranceStopsTheRefinement) {
  MemoryStream stream = scan(freeform, {.profiles = 250, .rows = 250, .sigma = 0.02});
  RangeFitOptions options;
  options.tolerance_mm = 0.5;
  const auto coarse = fit(stream, options);
  ASSERT_TRUE(coarse);
  EXPECT_THAT(coarse->report.stopped_by, HasSubstr("tolerance"));
  EXPECT_LE(coarse->report.residual_mm.p95, 0.52);
  EXPECT_GT(coarse->report.residual_mm.p95, 0.1);
  options.tolerance_mm = 0.01;  // below the noise
  const auto fine = fit(stream, options);
  ASSERT_TRUE(fine);
  EXPECT_THAT(fine->report.stopped_by, HasSubstr("was not reached"));
  EXPECT_LT(coarse->report.control_points_v, fine->report.control_points_v);
}

TEST(RangeFit, OutliersDoNotMoveTheSurface) {
  for (const double share : {0.02, 0.1, 0.2, 0.3}) {
    MemoryStream stream = scan(freeform, {.profiles = 300, .rows = 300, .sigma = 0.02});
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::size_t planted = 0;
    for (Profile& p : stream.profiles)
      for (double& r : p.r_mm)
        if (uniform(random) < share) r = 15 + 40 * uniform(random), ++planted;
    const auto f = fit(stream);
    ASSERT_TRUE(f) << f.error().message;
    EXPECT_LT(miss(f->function, freeform).rms, 0.004) << share;
    EXPECT_LT(miss(f->function, freeform).max, 0.06) << share;
    EXPECT_NEAR(static_cast<double>(f->report.rejected + f->report.unfollowable), static_cast<double>(planted),
                0.02 * static_cast<double>(planted));
    EXPECT_LT(f->report.unfollowable, planted / 50);
    EXPECT_NEAR(f->report.noise_mm, 0.02, 0.003);
    EXPECT_LE(stream.passes, 3);
  }
}

struct Strays {
  std::string name;
  std::function<bool(double theta, double z)> where;
  std::function<double(double r, double z, double chance)> range;
  double share;
};

// Outliers that err all to one side, near the surface and far from it, and reflections along a stripe where they even
// outnumber the surface: the same bounds.
TEST(RangeFit, OneSidedAndClusteredOutliersDoNotMoveTheSurface) {
  const auto everywhere = [](double, double) { return true; };
  const auto stripe = [](double t, double) { return std::abs(t - 2) < 0.15; };
  const auto slanting = [](double t, double z) { return std::abs(std::remainder(t - 2 - z / 40, 2 * kPi)) < 0.2; };
  const std::vector<Strays> all{
      {"outside", everywhere, [](double r, double, double u) { return r + 1 + 24 * u; }, 0.3},
      {"inside", everywhere, [](double r, double, double u) { return r - 1 - 15 * u; }, 0.3},
      {"just outside", everywhere, [](double r, double, double u) { return r + 0.2 + 2 * u; }, 0.3},
      {"reflection outside", stripe, [](double r, double, double u) { return r + 6 + 2 * u; }, 0.6},
      {"reflection inside", stripe, [](double r, double, double u) { return r - 6 - 2 * u; }, 0.6},
      {"slanting reflection", slanting, [](double r, double z, double u) { return r + 3 + z / 15 + u; }, 0.45},
      {"smeared reflection", stripe, [](double r, double, double u) { return r + 0.5 + 20 * u; }, 0.4}};
  for (const Strays& strays : all) {
    MemoryStream stream = scan(freeform, {.profiles = 300, .rows = 300, .sigma = 0.02});
    std::mt19937_64 random(4);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::size_t planted = 0;
    for (Profile& p : stream.profiles)
      for (std::size_t k = 0; k < p.size(); ++k)
        if (strays.where(p.theta_rad[k], p.z_mm[k]) && uniform(random) < strays.share)
          p.r_mm[k] = strays.range(p.r_mm[k], p.z_mm[k], uniform(random)), ++planted;
    const auto f = fit(stream);
    ASSERT_TRUE(f) << strays.name << ": " << f.error().message;
    EXPECT_LT(miss(f->function, freeform).rms, 0.004) << strays.name;
    EXPECT_LT(miss(f->function, freeform).max, 0.06) << strays.name;
    EXPECT_NEAR(static_cast<double>(f->report.rejected + f->report.unfollowable), static_cast<double>(planted),
                0.02 * static_cast<double>(planted))
        << strays.name;
    EXPECT_NEAR(f->report.noise_mm, 0.02, 0.004) << strays.name;
  }
}

// Few samples a cell, where chance makes outliers the majority of some: the error stays that of fewer samples.
TEST(RangeFit, OutliersDoNotMoveTheSurfaceOfSmallScans) {
  const auto run = [](double share) {
    MemoryStream stream = scan(freeform, {.profiles = 100, .rows = 100, .sigma = 0.02});
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> uniform(0, 1);
    for (Profile& p : stream.profiles)
      for (double& r : p.r_mm)
        if (uniform(random) < share) r = 15 + 40 * uniform(random);
    const auto f = fit(stream);
    return f ? miss(f->function, freeform).rms : 1e300;
  };
  const double clean = run(0);
  EXPECT_LT(run(0.1), 1.3 * clean);
  EXPECT_LT(run(0.3), 1.6 * clean);
}

// What is rejected is only what does not belong: a clean scan loses nothing, edges and all.
TEST(RangeFit, SharpFeaturesAreNoOutliers) {
  const auto stepped = [](double t, double z) {
    return 30 + (z > 50 ? 4 : 0) - (z > 80 ? 3 : 0) + (std::cos(3 * t) > 0.4 && z < 30 ? 1.0 : 0.0);
  };
  MemoryStream stream = scan(stepped, {.profiles = 400, .rows = 400, .sigma = 0.02});
  const auto f = fit(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_LT(static_cast<double>(f->report.rejected + f->report.unfollowable),
            0.01 * static_cast<double>(f->report.points));
}

// A handle 12 mm off the body and 10 mm wide, with the body measured behind it.
TEST(RangeFit, HandlesAreReportedAndLeftOut) {
  MemoryStream stream = scan(wavy_profile, {.profiles = 400, .rows = 300, .sigma = 0.05});
  std::size_t handle = 0;
  for (Profile& p : stream.profiles)
    for (std::size_t k = 0; k < p.size(); ++k)
      if (std::abs(p.theta_rad[k] - 2) < 0.17 && p.z_mm[k] > 30 && p.z_mm[k] < 90 && k % 2) p.r_mm[k] += 14, ++handle;
  const auto f = fit(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_NEAR(static_cast<double>(f->report.unfollowable), static_cast<double>(handle),
              0.1 * static_cast<double>(handle));
  EXPECT_LT(miss(f->function, wavy_profile).rms, 0.02);
  EXPECT_THAT(f->report.warnings, testing::Contains(HasSubstr("handles or undercuts")));
}

TEST(RangeFit, GapsAreBridgedAndReported) {
  const auto in_gap = [](double t, double z) { return t > 1 && t < 1 + 0.72 * kPi && z > 25 && z < 102; };  // 23 %
  const auto shape = [](double t, double z) { return 30 + 6 * std::sin(2 * kPi * z / 120) + 2 * std::cos(t); };
  MemoryStream stream = scan(shape, {.profiles = 300, .rows = 300, .sigma = 0.02});
  for (Profile& p : stream.profiles) {
    Profile kept;
    for (std::size_t k = 0; k < p.size(); ++k)
      if (!in_gap(p.theta_rad[k], p.z_mm[k])) test::push(kept, p.r_mm[k], p.theta_rad[k], p.z_mm[k]);
    p = kept;
  }
  const auto f = fit(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_NEAR(f->report.coverage, 1 - 0.36 * 77 / 120, 0.02);
  EXPECT_THAT(f->report.warnings, testing::Contains(HasSubstr("bridged")));
  EXPECT_LT(miss(f->function, shape, [&](double t, double z) { return !in_gap(t, z); }).rms, 0.004);
  EXPECT_LT(miss(f->function, shape).max, 8) << "bridged, not blown up";
}

TEST(RangeFit, RimsAreCutWhereTheyAreNotCoveredAllAround) {
  MemoryStream stream = scan(wavy_profile, {.profiles = 300, .rows = 301, .sigma = 0.02});
  for (Profile& p : stream.profiles) {
    Profile kept;
    const double top = 100 + 10 * std::sin(p.theta_rad[0]);
    for (std::size_t k = 0; k < p.size(); ++k)
      if (p.z_mm[k] < top) test::push(kept, p.r_mm[k], p.theta_rad[k], p.z_mm[k]);
    p = kept;
  }
  const auto f = fit(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_DOUBLE_EQ(f->report.z_start_mm, 0);
  EXPECT_NEAR(f->report.z_end_mm, 90, 0.6);  // the lowest point of the rim, seen in sectors of 22.5 degrees
  EXPECT_NEAR(f->report.cut_above_mm, 20, 1);
  EXPECT_DOUBLE_EQ(f->function.base().band_end, f->report.z_end_mm);
  EXPECT_THAT(f->report.warnings, testing::Contains(HasSubstr("upper rim")));
}

// Every other profile has uncertain heights: what that does to the ranges follows from the slope, and so do the
// weights.
TEST(RangeFit, CovariancesWeighTheSamples) {
  const auto steep = [](double, double z) { return 30 + 16 * std::sin(2 * kPi * z / 40); };
  MemoryStream stream = scan(steep, {.profiles = 60, .rows = 300, .sigma = 0.005, .seed = 3});
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  for (Profile& p : stream.profiles)
    for (std::size_t k = 0; k < p.size() && p.index % 2; ++k)
      p.z_mm[k] = std::clamp(p.z_mm[k] + 0.04 * normal(random), 0.0, 120.0);
  RangeFitOptions options;
  options.z_intervals = 64;
  options.intervals_per_arc = 1;
  options.model = SurfaceModel::revolution;
  options.smoothing = options.robust = false;
  const auto where = [](double, double z) { return z > 2 && z < 118; };
  const auto plain = fit(stream, options);
  ASSERT_TRUE(plain) << plain.error().message;
  for (Profile& p : stream.profiles) {
    SampleCovariance c;
    c.rr = 0.005F * 0.005F;
    c.zz = p.index % 2 ? 0.04F * 0.04F : 0;
    p.covariance.assign(p.size(), c);
  }
  const auto weighted = fit(stream, options);
  ASSERT_TRUE(weighted) << weighted.error().message;
  EXPECT_LT(miss(weighted->function, steep, where).rms, 0.3 * miss(plain->function, steep, where).rms);
}

TEST(RangeFit, SameInputGivesIdenticalBytes) {
  const auto run = [] {
    MemoryStream stream = scan(freeform, {.profiles = 150, .rows = 150, .sigma = 0.02, .correlation = 0.5});
    for (std::size_t k = 0; k < 40; ++k) stream.profiles[3 * k].r_mm[k] += 5;
    return fit(stream);
  };
  const auto a = run(), b = run();
  ASSERT_TRUE(a && b);
  ASSERT_EQ(a->surface.control_points.size(), b->surface.control_points.size());
  EXPECT_EQ(std::memcmp(a->surface.control_points.data(), b->surface.control_points.data(),
                        static_cast<std::size_t>(a->surface.control_points.size()) * sizeof(double)),
            0);
  EXPECT_EQ(a->report.residual_mm.p95, b->report.residual_mm.p95);
}

TEST(RangeFit, PreviewFromSumsAloneIsCloseToTheFit) {
  MemoryStream stream = scan(freeform, {.profiles = 300, .rows = 300, .sigma = 0.02});
  const auto grid = choose_grid(stream, {});
  ASSERT_TRUE(grid);
  const MomentGrid sums = test::accumulate(stream, *grid);
  const auto f = fit_sums(sums);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_EQ(f->report.model, SurfaceModel::general);
  EXPECT_NEAR(f->report.residual_mm.rms, 0.02, 0.001);
  EXPECT_LT(miss(f->function, freeform).rms, 0.006);
  // A quarter of the turn is enough for a preview.
  MemoryStream quarter = stream;
  quarter.profiles.resize(stream.profiles.size() / 4);
  const auto part = fit_sums(test::accumulate(quarter, *grid));
  ASSERT_TRUE(part) << part.error().message;
  EXPECT_LT(part->report.residual_mm.rms, 0.03);
  EXPECT_NEAR(part->report.coverage, 0.25, 0.03);
}

std::string refusal(MemoryStream stream, const RangeFitOptions& options = {}) {
  const auto f = fit(stream, options);
  return f ? "fitted" : f.error().message;
}

// A platter under a thin stem: splines swing at the step, here through the axis, and no solid may come of that.
TEST(RangeFit, ASurfaceThatWouldCrossTheAxisIsRefused) {
  test::ScanSetting setting;
  setting.profiles = 90;
  setting.rows = 60;
  setting.sigma = 0.01;
  auto stream = test::scan([](double, double z) { return z < 40 ? 90.0 : 2.0; }, setting);
  const auto f = test::fit(stream);
  ASSERT_FALSE(f);
  EXPECT_THAT(f.error().message, HasSubstr("cross the axis at z = 4"));
}

TEST(RangeFit, RefusalsSayWhatIsWrong) {
  MemoryStream none;
  EXPECT_THAT(refusal(none), HasSubstr("no samples"));
  MemoryStream axis = scan([](double, double) { return 0.0; }, {.profiles = 10, .rows = 10});
  EXPECT_THAT(refusal(axis), HasSubstr("all 100 samples lie on the axis"));
  MemoryStream nan = scan([](double, double) { return std::nan(""); }, {.profiles = 10, .rows = 10});
  EXPECT_THAT(refusal(nan), HasSubstr("none of the 100 samples is a finite number"));
  MemoryStream ring = scan(cylinder, {.profiles = 50, .rows = 2, .height = 0});
  EXPECT_THAT(refusal(ring), HasSubstr("the same height"));
  MemoryStream few = test::scattered(cylinder, 12, 0.02);
  EXPECT_THAT(refusal(few), HasSubstr("samples are fewer than the 16 unknowns"));
  MemoryStream slice = scan(cylinder, {.profiles = 400, .rows = 50, .sigma = 0.01});
  slice.profiles.resize(100);
  EXPECT_THAT(refusal(slice), HasSubstr("at least half of the turn"));
  RangeFitOptions options;
  options.degree_u = 7;
  EXPECT_THAT(refusal(slice, options), HasSubstr("must both lie in 1..5"));
  options = {};
  options.z_intervals = 8;
  EXPECT_THAT(refusal(slice, options), HasSubstr("both directions or for none"));
  options.intervals_per_arc = 3;
  EXPECT_THAT(refusal(slice, options), HasSubstr("powers of two"));

  // Sums and options that do not belong together.
  MemoryStream whole = scan(cylinder, {.profiles = 100, .rows = 100, .sigma = 0.01});
  const MomentGrid sums = test::accumulate(whole, {0, 120, 8, 4, 3, 3});
  options = {};
  options.degree_v = 4;
  EXPECT_THAT(fit_range(sums, whole, options).error().message, HasSubstr("what the sums were made for"));
  options = {};
  options.z_intervals = 64;
  options.intervals_per_arc = 4;
  EXPECT_THAT(fit_range(sums, whole, options).error().message, HasSubstr("not among those of the sums"));
  const MomentGrid outside = test::accumulate(whole, {200, 300, 8, 4, 3, 3});
  EXPECT_THAT(fit_range(outside, whole).error().message, HasSubstr("outside the band"));
}

// Fifteen grooves: a scanner's sums have four intervals for each. A revolution gets as many as it takes, from the
// second pass.
TEST(RangeFit, RevolutionsRefineAlongTheAxisBeyondTheSums) {
  const auto grooves = [](double, double z) { return 30 + 0.2 * std::sin(2 * kPi * z / 8); };
  for (const bool outliers : {false, true}) {
    MemoryStream stream = scan(grooves, {.profiles = 120, .rows = 960, .sigma = 0.02});
    for (Profile& p : stream.profiles)
      for (std::size_t k = p.index % 50; outliers && k < p.size(); k += 50) p.r_mm[k] += 12;
    const MomentGrid sums = test::accumulate(stream, {-5, 125, 64, 8, 3, 3});
    stream.passes = 0;
    const auto f = fit_range(sums, stream);
    ASSERT_TRUE(f) << f.error().message;
    EXPECT_EQ(f->report.model, SurfaceModel::revolution) << f->report.decided_by;
    EXPECT_GT(f->report.control_points_u, 100);
    EXPECT_LT(miss(f->function, grooves).rms, 0.0015) << outliers;
    EXPECT_THAT(f->report.stopped_by, HasSubstr("Cp"));
    EXPECT_LE(stream.passes, 3);
  }
}

// A number of rows that a power of two divides: the first and the last row are in the grid like any other.
TEST(RangeFit, GridReachesTheOutermostRowsOfEveryProfile) {
  for (const int rows : {120, 128, 960}) {
    MemoryStream stream = scan(cylinder, {.profiles = 400, .rows = rows, .sigma = 0.01});
    const auto grid = choose_grid(stream, {});
    ASSERT_TRUE(grid);
    EXPECT_EQ(grid->z_start_mm, 0) << rows;
    EXPECT_EQ(grid->z_end_mm, 120) << rows;
  }
}

TEST(RangeFit, StrayHeightsDoNotWidenTheGrid) {
  MemoryStream stream = scan(cylinder, {.profiles = 100, .rows = 100, .sigma = 0.01});
  stream.profiles[5].z_mm[7] = 1e6;
  stream.profiles[50].z_mm[7] = -4000;
  const auto grid = choose_grid(stream, {});
  ASSERT_TRUE(grid);
  EXPECT_GE(grid->z_start_mm, -10);
  EXPECT_LE(grid->z_end_mm, 130);
  const auto f = fit(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_EQ(f->report.model, SurfaceModel::cylinder);
  EXPECT_EQ(f->report.rejected, 2u);
}

// A dent that no spline of so few knots follows shows where it is.
TEST(RangeFit, TheMapOfErrorsShowsWhereASurfaceMisses) {
  const auto dented = [](double t, double z) {
    const double far = std::hypot((t - 2) / 0.15, (z - 80) / 4);
    return 30 - 0.5 * std::exp(-far * far);
  };
  MemoryStream stream = test::scattered(dented, 200000, 0.01);
  const auto fitted =
      fit(stream, {.model = SurfaceModel::revolution, .z_intervals = 4, .intervals_per_arc = 1, .robust = false});
  ASSERT_TRUE(fitted) << fitted.error().message;
  const ErrorMap& map = fitted->geometric_errors;
  ASSERT_FALSE(map.empty());
  double least = 0, elsewhere = 0;
  int at_row = -1, at_column = -1;
  for (int i = 0; i < ErrorMap::kAlong; ++i)
    for (int j = 0; j < ErrorMap::kAround; ++j) {
      const auto mean = map.mean_mm(i, j);
      ASSERT_TRUE(mean);
      if (*mean < least) least = *mean, at_row = i, at_column = j;
      const double t = 2 * kPi * (j + 0.5) / ErrorMap::kAround, z = 120 * (i + 0.5) / ErrorMap::kAlong;
      if (std::hypot((t - 2) / 0.15, (z - 80) / 4) > 4) elsewhere = std::max(elsewhere, std::abs(*mean));
    }
  EXPECT_NEAR((at_column + 0.5) * 2 * kPi / ErrorMap::kAround, 2, 0.05);
  EXPECT_NEAR((at_row + 0.5) * 120 / ErrorMap::kAlong, 80, 3);
  EXPECT_LT(least, -0.4);
  EXPECT_LT(elsewhere, 0.05);
}

// Fairing takes bending away within its bound, and nothing from the size.
TEST(RangeFit, FairingStaysWithinItsBoundAndShrinksNothing) {
  const auto body = [](double t, double z) { return 30 + 4 * std::sin(2 * kPi * z / 120) + 3 * std::cos(2 * t); };
  MemoryStream stream = test::scattered(body, 40000, 0.1);
  const RangeFitOptions plain{.z_intervals = 32, .intervals_per_arc = 16, .smoothing = false};
  const auto rough = fit(stream, plain);
  ASSERT_TRUE(rough) << rough.error().message;
  const auto waviness = [&](const RangeFunction& f) {
    double square = 0;
    int n = 0;
    for (double z = 5; z < 115; z += 1)
      for (double t = 0.05; t < 6.2; t += 0.1, ++n) {
        const double r_zz = 4 * std::sin(2 * kPi * z / 120) * -std::pow(2 * kPi / 120, 2);
        square += std::pow(f.derivatives(t, z).r_z_z - r_zz, 2);
      }
    return std::sqrt(square / n);
  };
  double last = waviness(rough->function);
  for (const double bound : {0.005, 0.02, 0.08}) {
    RangeFitOptions options = plain;
    options.fair_mm = bound;
    const auto fair = fit(stream, options);
    ASSERT_TRUE(fair) << fair.error().message;
    double mean = 0;
    std::vector<double> moved;
    for (double z = 0; z <= 120; z += 1)
      for (double t = 0; t < 6.28; t += 0.1) {
        moved.push_back(std::abs(fair->function(t, z) - rough->function(t, z)));
        mean += fair->function(t, z) - rough->function(t, z);
      }
    const auto n = static_cast<double>(moved.size());
    std::sort(moved.begin(), moved.end());
    const double most = moved[static_cast<std::size_t>(0.95 * n)];
    EXPECT_LE(most, 1.1 * bound);
    EXPECT_GT(most, 0.8 * bound);
    EXPECT_LT(std::abs(mean / n), 0.01 * bound);
    EXPECT_LT(waviness(fair->function), last);
    last = waviness(fair->function);
    EXPECT_NE(fair->report.stopped_by.find("faired: 95 %"), std::string::npos);
  }
  // A bound like the noise of the rough surface finds the smooth one behind it.
  EXPECT_LT(last, 0.1 * waviness(rough->function));
  MemoryStream round = test::scattered([](double, double) { return 25; }, 20000, 0.05);
  const auto cylinder_again = fit(round, {.fair_mm = 1});
  ASSERT_TRUE(cylinder_again);
  EXPECT_EQ(cylinder_again->report.model, SurfaceModel::cylinder);
  EXPECT_NEAR(cylinder_again->function(0, 60), 25, 1e-3);
}

}  // namespace
}  // namespace celadon
