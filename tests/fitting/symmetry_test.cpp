// Symmetric surfaces against closed forms, and against themselves turned and mirrored.
#include "fitting/symmetry.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <random>
#include <string>

#include "fitting/section.h"
#include "fitting/signed_distance.h"
#include "fitting/solid_properties.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::kPi;

tl::expected<RangeFit, FitError> fit_symmetric(test::MemoryStream& samples, const Symmetry& symmetry,
                                               RangeFitOptions options = {}) {
  FoldedStream folded(samples, symmetry);
  options.arcs = symmetry.sector();
  auto fit = fit_samples(folded, options);
  if (!fit) return fit;
  return unfolded(std::move(*fit), symmetry);
}

// Any function over a sector, laid out around: it repeats, is its own mirror image, and r(theta) is twice
// differentiable where sectors meet.
RC_GTEST_PROP(Symmetry, AnyFunctionRepeatsWithoutABreak, ()) {
  Symmetry symmetry;
  symmetry.fold = *rc::gen::inRange(1, 10);
  symmetry.mirrored = *rc::gen::arbitrary<bool>();
  symmetry.plane_rad = symmetry.mirrored ? 0.001 * *rc::gen::inRange(0, 6283) : 0;
  const int degree = *rc::gen::inRange(0, 6), intervals = *rc::gen::inRange(1, 6);
  const BaseArcs arcs = symmetry.sector();
  const RangeSpace space = degree == 0 ? RangeSpace::constant({0, static_cast<double>(arcs.count())})
                                       : RangeSpace::over(degree, arcs, intervals);
  Eigen::MatrixXd free(1, space.free_count());
  for (Eigen::Index k = 0; k < free.size(); ++k) free(0, k) = 30 + 0.01 * *rc::gen::inRange(-300, 301);
  BaseSurface base;
  base.arcs = arcs;
  const RangeFunction sector(base, 0, degree, {0, 1}, space.knots(), free * space.extraction().transpose());
  const RangeFunction whole = unfolded(sector, symmetry);
  RC_ASSERT(whole.base().arcs.closed());
  for (int k = 0; k < 60; ++k) {
    const double t = arcs.start_rad() + 2 * kPi * (k + 0.31) / 60, turn = 2 * kPi / symmetry.fold;
    RC_ASSERT(std::abs(whole(t + turn, 0.5) - whole(t, 0.5)) < 1e-11);
    if (symmetry.mirrored) RC_ASSERT(std::abs(whole(2 * symmetry.plane_rad - t, 0.5) - whole(t, 0.5)) < 1e-11);
  }
  for (int k = 0; k < 20; ++k) {
    const double t = arcs.start_rad() + arcs.arc_rad() * arcs.count() * (k + 0.5) / 20;
    RC_ASSERT(std::abs(whole(t, 0.5) - sector(t, 0.5)) < 1e-11);
  }
  if (degree >= 3)
    for (int joint = 0; joint < whole.base().arcs.count(); ++joint) {
      const double t = arcs.start_rad() + arcs.arc_rad() * joint, h = 1e-9;
      const auto before = whole.derivatives(t - h, 0.5), after = whole.derivatives(t + h, 0.5);
      RC_ASSERT(std::abs(before.r_theta - after.r_theta) < 1e-4);
      RC_ASSERT(std::abs(before.r_theta_theta - after.r_theta_theta) < 2e-3);
    }
  // F times the circle of many arcs.
  const NurbsSurface surface = symbolic_product(whole);
  for (int k = 0; k < 20; ++k) {
    const double v = whole.base().arcs.count() * (k + 0.37) / 20, t = whole.base().arcs.theta_of_v(v);
    const Eigen::Vector3d p = surface.evaluate(0.5, v);
    const double r = whole(t, 0.5);
    RC_ASSERT((p - Eigen::Vector3d(r * std::cos(t), r * std::sin(t), 0.5)).norm() < 1e-10);
  }
}

// What comes after a fit takes circles of any number of arcs.
TEST(Symmetry, SectionsAndDistancesOfManyArcs) {
  const Symmetry symmetry{5, true, 0.4};
  const RangeSpace space = RangeSpace::over(3, symmetry.sector(), 3);
  Eigen::MatrixXd free(2, space.free_count());
  for (Eigen::Index k = 0; k < free.size(); ++k) free.data()[k] = 25 + std::sin(2.0 * static_cast<double>(k));
  BaseSurface base;
  base.arcs = symmetry.sector();
  base.band_end = 40;
  const RangeFunction f = unfolded(
      RangeFunction(base, 1, 3, {0, 0, 1, 1}, space.knots(), free * Eigen::MatrixXd(space.extraction().transpose())),
      symmetry);
  ASSERT_EQ(f.base().arcs.count(), 10);
  const SignedDistance distance(f);
  std::mt19937_64 random(2);
  std::uniform_real_distribution<double> share(0, 1);
  for (int k = 0; k < 500; ++k) {
    const double t = 2 * kPi * share(random), r = 15 + 20 * share(random), z = 40 * share(random);
    const double x = r * std::cos(t), y = r * std::sin(t);
    double ray = 0, across = 0;
    distance.along_ray(&x, &y, &z, 1, &ray);
    distance.to_surface(&x, &y, &z, 1, &across);
    const auto member = f.membership({x, y, z});
    EXPECT_NEAR(ray, r - f(t, z), 1e-11);
    EXPECT_NEAR(across, member.signed_distance_mm, 1e-10);
  }
  const Section cut = section(f, 13);
  constexpr int kCorners = 200000;
  double area = 0;
  for (int k = 0; k < kCorners; ++k) area += std::pow(f(2 * kPi * k / kCorners, 13), 2) * kPi / kCorners;
  EXPECT_NEAR(cut.area_mm2, area, 1e-6);
  EXPECT_LT(cut.centroid_mm.head<2>().norm(), 1e-11);
}

test::Shape lobed_shape(int fold, double plane, double skew) {
  return [=](double t, double z) {
    const double a = fold * (t - plane);
    return 30 + 2 * std::cos(a) * std::sin(kPi * z / 120) + std::cos(2 * a) + skew * std::sin(2 * a) + 0.03 * z;
  };
}

// Noise falls with the root of the number of sectors, but for what other knots make of it.
TEST(Symmetry, FitsKnowEveryOtherSector) {
  const test::Shape truth = lobed_shape(5, 0.4, 0);
  test::MemoryStream noisy = test::scan(truth, {.profiles = 400, .rows = 150, .sigma = 0.05});
  const auto plain = fit_samples(noisy);
  ASSERT_TRUE(plain);
  const double alone = test::miss(plain->function, truth).rms;
  for (const bool mirrored : {false, true}) {
    const Symmetry symmetry{5, mirrored, mirrored ? 0.4 : 0};
    const auto fit = fit_symmetric(noisy, symmetry);
    ASSERT_TRUE(fit) << fit.error().message;
    EXPECT_EQ(fit->report.model, SurfaceModel::general);
    const double together = test::miss(fit->function, truth).rms;
    EXPECT_LT(together, 1.4 * alone / std::sqrt(symmetry.sectors())) << mirrored;
    EXPECT_NEAR(fit->report.noise_mm, 0.05, 0.002);
    EXPECT_NEAR(fit->report.sd_mean_mm, together, 0.3 * together);
    ASSERT_TRUE(fit->deviation);
    EXPECT_EQ(fit->deviation->v().back(), fit->function.base().arcs.count());
    for (int k = 0; k < 10; ++k)
      EXPECT_NEAR((*fit->deviation)(fit->function.base().arcs.v_of_theta(0.1 + k * 0.2), 60),
                  (*fit->deviation)(fit->function.base().arcs.v_of_theta(0.1 + k * 0.2 + 2 * kPi / 5), 60), 1e-9);
    EXPECT_EQ(fit->report.control_points_v, fit->surface.count_v());
  }
}

TEST(Symmetry, NoiseFreeBodiesAreRecovered) {
  for (const int fold : {1, 2, 3, 4, 7}) {
    const test::Shape truth = lobed_shape(fold, 0.3, 0);
    test::MemoryStream stream = test::scan(truth, {.profiles = 360, .rows = 120});
    const auto fit = fit_symmetric(stream, {fold, true, 0.3});
    ASSERT_TRUE(fit) << fold << fit.error().message;
    EXPECT_LT(test::miss(fit->function, truth).max, 2e-4) << fold;
  }
}

// What is simpler stays exact over any number of arcs.
TEST(Symmetry, CylindersAndRevolutionsStayExact) {
  test::MemoryStream cylinder = test::scan([](double, double) { return 20.0; }, {.profiles = 70, .rows = 60});
  auto fit = fit_symmetric(cylinder, {5, false, 0});
  ASSERT_TRUE(fit);
  EXPECT_EQ(fit->report.model, SurfaceModel::cylinder);
  EXPECT_EQ(fit->surface.count_v(), 11);
  EXPECT_NEAR(solid_properties(fit->surface).volume_mm3, 400 * kPi * 120, 1e-6);
  test::MemoryStream cone = test::scan([](double, double z) { return 20 + z / 10; }, {.profiles = 70, .rows = 60});
  fit = fit_symmetric(cone, {3, true, 0.2});
  ASSERT_TRUE(fit);
  EXPECT_EQ(fit->report.model, SurfaceModel::revolution);
  EXPECT_NEAR(solid_properties(fit->surface).volume_mm3, kPi * 120 / 3 * (400 + 20 * 32 + 32 * 32), 1e-5);
}

TEST(Symmetry, SamplesAndCovariancesAreFolded) {
  test::MemoryStream stream;
  Profile p;
  test::push(p, 10, 0.5 + 0.2, 1);
  test::push(p, 11, 0.5 - 0.2, 2);
  test::push(p, 12, 0.5 + 2 * kPi / 3 - 0.3, 3);
  p.covariance.assign(3, {.rr = 1, .rt = 2, .rz = 3, .tt = 4, .tz = 5, .zz = 6});
  stream.profiles.push_back(p);
  FoldedStream folded(stream, {3, true, 0.5});
  folded.rewind();
  const Profile* q = folded.next();
  ASSERT_TRUE(q);
  EXPECT_NEAR(q->theta_rad[0], 0.7, 1e-12);
  EXPECT_NEAR(q->theta_rad[1], 0.7, 1e-12);
  EXPECT_NEAR(q->theta_rad[2], 0.8, 1e-12);
  EXPECT_EQ(q->covariance[0].rt, 2);
  EXPECT_EQ(q->covariance[1].rt, -2);
  EXPECT_EQ(q->covariance[1].tz, -5);
  EXPECT_EQ(q->covariance[1].rz, 3);
  EXPECT_EQ(q->r_mm, p.r_mm);
}

TEST(Symmetry, TheMirrorPlaneIsFound) {
  for (const int fold : {1, 3, 6}) {
    test::MemoryStream stream =
        test::scan(lobed_shape(fold, 0.21, 0), {.profiles = 300, .rows = 100, .sigma = 0.05, .seed = 7});
    const auto fit = fit_symmetric(stream, {fold, false, 0});
    ASSERT_TRUE(fit);
    const auto plane = find_mirror_plane(fit->function, fold);
    ASSERT_TRUE(plane) << plane.error().message;
    const double period = kPi / fold;
    EXPECT_LT(std::abs(std::remainder(*plane - 0.21, period)), 1e-3) << fold;
    EXPECT_GE(*plane, 0);
    EXPECT_LT(*plane, period);
  }
  test::MemoryStream round = test::scan([](double, double z) { return 20 + z / 10; }, {});
  const auto of_round = fit_samples(round);
  ASSERT_TRUE(of_round);
  EXPECT_NE(find_mirror_plane(of_round->function, 1).error().message.find("at every angle"), std::string::npos);
  // Lobes that lean over, with the height too: nothing about them is like its mirror image.
  test::MemoryStream leaning = test::scan(
      [](double t, double z) { return 30 + std::cos(4 * t) + std::sin(8 * t + 0.2 * z) + std::cos(12 * t - 0.3 * z); },
      {});
  const auto of_leaning = fit_samples(leaning);
  ASSERT_TRUE(of_leaning);
  const auto none = find_mirror_plane(of_leaning->function, 4);
  ASSERT_FALSE(none) << *none;
  EXPECT_NE(none.error().message.find("leave the mirror out"), std::string::npos);
}

}  // namespace
}  // namespace celadon
