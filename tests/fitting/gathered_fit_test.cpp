#include "fitting/gathered_fit.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "fitting/cell_residuals.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::freeform;
using test::kPi;

// What several machines have gathered of parts of a stream, as one.
GatheredSamples gathered_in_parts(const test::MemoryStream& stream, const GridSpecification& grid, std::size_t parts) {
  std::vector<test::MemoryStream> shares(parts);
  for (std::size_t k = 0; k < stream.profiles.size(); ++k) shares[k % parts].profiles.push_back(stream.profiles[k]);
  GatheredSamples all = gather(shares.front(), grid);
  for (std::size_t k = 1; k < parts; ++k) merge(all, gather(shares[k], grid));
  return all;
}

double largest_difference(const RangeFunction& a, const RangeFunction& b) {
  if (a.coefficients().rows() != b.coefficients().rows() || a.coefficients().cols() != b.coefficients().cols())
    return 1e300;
  return (a.coefficients() - b.coefficients()).cwiseAbs().maxCoeff();
}

// While all samples are kept, nothing of a fit to the samples is missing.
TEST(GatheredFit, IsTheFitToTheSamplesWhileAllAreKept) {
  test::MemoryStream stream = test::scattered(freeform, 60000, 0.02, 5);
  const auto grid = choose_grid(stream, {});
  ASSERT_TRUE(grid);
  const auto whole = fit_samples(stream, {}), merged = fit_gathered(gathered_in_parts(stream, *grid, 3));
  ASSERT_TRUE(whole && merged);
  EXPECT_LT(largest_difference(whole->function, merged->function), 1e-10);
  EXPECT_NEAR(merged->report.kappa, whole->report.kappa, 1e-9);
  EXPECT_NEAR(merged->report.noise_mm, whole->report.noise_mm, 1e-9);
  EXPECT_NEAR(merged->report.residual_mm.rms, whole->report.residual_mm.rms, 1e-9);
  EXPECT_EQ(merged->report.rejected, whole->report.rejected);
  EXPECT_NEAR(merged->report.sd_mean_mm / whole->report.sd_mean_mm, 1, 1e-6);
  EXPECT_TRUE(merged->report.warnings.empty());
}

// Beyond that the surface is still that of all samples; what is of the kept ones is said.
TEST(GatheredFit, HasTheSumsOfAllSamplesAndTheErrorsOfTheKept) {
  test::MemoryStream stream = test::scattered(freeform, 300000, 0.02, 6);
  const auto grid = choose_grid(stream, {});
  const GatheredSamples samples = gathered_in_parts(stream, *grid, 4);
  ASSERT_LT(samples.look.samples().size(), 200000u);
  const auto whole = fit_samples(stream, {}), merged = fit_gathered(samples);
  ASSERT_TRUE(whole && merged);
  EXPECT_LT(largest_difference(whole->function, merged->function), 1e-10);
  EXPECT_EQ(merged->report.points, 300000u);
  EXPECT_EQ(merged->report.rejected, whole->report.rejected);
  EXPECT_NEAR(merged->report.noise_mm, 0.02, 2e-4);
  EXPECT_NEAR(merged->report.residual_mm.p95 / whole->report.residual_mm.p95, 1, 0.01);
  ASSERT_EQ(merged->report.warnings.size(), 1u);
  EXPECT_NE(merged->report.warnings[0].find("even sample"), std::string::npos);
}

TEST(GatheredFit, OfOutliersIsRobustAndSaysHow) {
  test::MemoryStream stream = test::scattered(freeform, 300000, 0.02, 7);
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> share(0, 1);
  for (Profile& p : stream.profiles)
    for (double& r : p.r_mm)
      if (share(random) < 0.1) r = 20 + 30 * share(random);
  const auto grid = choose_grid(stream, {});
  const auto merged = fit_gathered(gathered_in_parts(stream, *grid, 2));
  ASSERT_TRUE(merged);
  EXPECT_LT(test::miss(merged->function, freeform).rms, 0.004);
  EXPECT_NEAR(static_cast<double>(merged->report.rejected) / 300000, 0.1, 0.005);
  EXPECT_TRUE(std::any_of(merged->report.warnings.begin(), merged->report.warnings.end(), [](const std::string& text) {
    return text.find("was fitted to an even sample") != std::string::npos;
  }));
}

// The same samples are kept in whatever order they come.
TEST(GatheredFit, TheKeptSamplesDoNotDependOnTheOrder) {
  test::MemoryStream stream = test::scattered(freeform, 400000, 0.02, 8);
  const GridSpecification grid{0, 120, 16, 4, 3, 3};
  const auto hashes_of = [](const GatheredSamples& samples) {
    auto hashes = samples.look.sample().hashes();
    std::sort(hashes.begin(), hashes.end());
    return hashes;
  };
  const auto in_order = hashes_of(gather(stream, grid));
  EXPECT_LE(in_order.size(), FirstLook::kSamples);
  EXPECT_GE(in_order.size(), FirstLook::kSamples / 3);
  EXPECT_EQ(hashes_of(gathered_in_parts(stream, grid, 5)), in_order);
  std::reverse(stream.profiles.begin(), stream.profiles.end());
  EXPECT_EQ(hashes_of(gather(stream, grid)), in_order);
}

TEST(GatheredFit, SumsOfOtherGridsAreAProgrammersError) {
  GatheredSamples a{MomentGrid({0, 120, 16, 4, 3, 3}), FirstLook(MomentGrid({0, 120, 16, 4, 3, 3}))},
      b{MomentGrid({0, 120, 8, 4, 3, 3}), FirstLook(MomentGrid({0, 120, 8, 4, 3, 3}))};
  EXPECT_THROW(merge(a, b), std::invalid_argument);
}

// Errors alike in patches of half a millimetre: so many samples share one, and the means of cells vary as much more.
TEST(ScatteredKappa, IsThatOfPatchesFromTheSumsAlone) {
  const GridSpecification grid{0, 120, 64, 32, 3, 3};
  for (const bool patches : {false, true}) {
    std::mt19937_64 random(3);
    std::normal_distribution<double> normal;
    std::uniform_real_distribution<double> share(0, 1);
    std::vector<double> errors(240 * 377);
    for (double& e : errors) e = 0.02 * normal(random);
    std::vector<double> count(errors.size());
    MomentGrid sums(grid);
    for (int k = 0; k < 200000; ++k) {
      const double theta = 2 * kPi * share(random), z = 120 * share(random);
      const auto patch =
          static_cast<std::size_t>(2 * z) * 377 + std::min<std::size_t>(376, static_cast<std::size_t>(theta * 60));
      ++count[patch];
      const double r = 30 + (patches ? errors[patch] : 0.02 * normal(random));
      sums.add({&r, 1}, {&theta, 1}, {&z, 1});
    }
    double expected = 1;  // sum n^2 / sum n
    if (patches) {
      double square = 0;
      for (const double n : count) square += n * n;
      expected = square / 200000;
    }
    const FitLadder ladder(sums, {0, 64}, 3, 3, JointContinuity::curvature);
    const auto member = solve_member(ladder, {2, 2}, {});
    EXPECT_NEAR(scattered_kappa(sums, *member) / expected, 1, patches ? 0.15 : 1e-12) << expected;
  }
}

}  // namespace
}  // namespace celadon
