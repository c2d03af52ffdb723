// Noise correlation, error histogram, coverage.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <random>

#include "fitting/coverage.h"
#include "fitting/error_histogram.h"
#include "fitting/model_selection.h"
#include "fitting/noise_correlation.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::kPi;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Of the scan's errors themselves.
Inflation inflation_of(const test::MemoryStream& stream) {
  NoiseCorrelation correlation(
      {.z_start_mm = 0, .z_end_mm = 120, .arcs = 4, .samples = stream.points(), .unknowns = 16, .unknowns_around = 4});
  const BaseArcs arcs = BaseArcs::full_circle();
  for (const Profile& p : stream.profiles) {
    std::vector<double> v(p.size()), e(p.size());
    arcs.synchronise(p.theta_rad.data(), p.size(), v.data());
    for (std::size_t k = 0; k < p.size(); ++k) e[k] = p.r_mm[k] - 30;
    if (p.index % 7 == 3) e[p.size() / 2] = kNan;
    correlation.add(p, v.data(), e.data());
  }
  return correlation.inflation();
}
double kappa_of(const test::MemoryStream& stream) {
  return inflation_of(stream).total();
}

double cylinder(double, double) {
  return 30;
}

TEST(NoiseCorrelation, WhiteNoiseHasNone) {
  EXPECT_EQ(kappa_of(test::scan(cylinder, {.profiles = 300, .rows = 300, .sigma = 0.02})), 1);
}

// 1 + 2 (a + a^2 + ...) = (1 + a)/(1 - a), cut where a^k < 0.03.
TEST(NoiseCorrelation, AutoregressiveLinesHaveTheirClosedForm) {
  EXPECT_NEAR(kappa_of(test::scan(cylinder, {.profiles = 400, .rows = 400, .sigma = 0.02, .correlation = 0.5})), 2.94,
              0.15);
  EXPECT_NEAR(kappa_of(test::scan(cylinder, {.profiles = 400, .rows = 400, .sigma = 0.02, .correlation = 0.8})), 8.7,
              0.6);
}

// An error common to a profile of n rows inflates a mean's variance by 1 + n s^2/sigma^2, over the total variance.
TEST(NoiseCorrelation, ErrorsCommonToAProfileCount) {
  const double n = 300, ratio = 0.25;  // (0.01/0.02)^2
  EXPECT_NEAR(kappa_of(test::scan(cylinder, {.profiles = 600, .rows = 300, .sigma = 0.02, .profile_sigma = 0.01})),
              (1 + n * ratio) / (1 + ratio), 12);
  // Too small to show in the correlation of neighbours, not between profiles.
  EXPECT_GT(kappa_of(test::scan(cylinder, {.profiles = 600, .rows = 300, .sigma = 0.02, .profile_sigma = 0.003})), 4);
}

// Within a profile the correlation of its own errors remains, of the part of the variance that is not common.
TEST(NoiseCorrelation, CommonAndCorrelatedErrorsAreToldApart) {
  const Inflation both = inflation_of(
      test::scan(cylinder, {.profiles = 600, .rows = 300, .sigma = 0.02, .correlation = 0.5, .profile_sigma = 0.02}));
  EXPECT_NEAR(both.within, 2.94 / 2, 0.2);
  EXPECT_NEAR(both.common, 300 * 0.5, 20);
  const Inflation white =
      inflation_of(test::scan(cylinder, {.profiles = 600, .rows = 300, .sigma = 0.02, .profile_sigma = 0.02}));
  EXPECT_NEAR(white.within, 0.5, 0.05);
  EXPECT_EQ(
      inflation_of(test::scan(cylinder, {.profiles = 600, .rows = 300, .sigma = 0.02, .correlation = 0.5})).common, 0);
}

TEST(NoiseCorrelation, CorrelationFromProfileToProfileCounts) {
  test::MemoryStream stream = test::scan(cylinder, {.profiles = 500, .rows = 200, .sigma = 0.02});
  for (std::size_t i = stream.profiles.size() - 1; i > 0; --i)  // moving average of two: rho_1 = 1/2
    for (std::size_t k = 0; k < 200; ++k)
      stream.profiles[i].r_mm[k] =
          (stream.profiles[i].r_mm[k] + stream.profiles[i - 1].r_mm[k]) / std::sqrt(2) + 30 * (1 - std::sqrt(2));
  EXPECT_NEAR(kappa_of(stream), 2, 0.15);
}

TEST(NoiseCorrelation, ScatteredPointsAreJudgedByTheirCells) {
  EXPECT_NEAR(kappa_of(test::scattered(cylinder, 100000, 0.02)), 1, 0.3);
  // Patches of 4 mm share an error as large as the noise: about forty samples each.
  std::mt19937_64 random(4);
  std::normal_distribution<double> normal;
  std::vector<double> patch(31 * 48);
  for (double& e : patch) e = 0.02 * normal(random);
  const auto patchy = [&](double t, double z) {
    return 30 + patch[static_cast<std::size_t>(z / 4) * 48 + static_cast<std::size_t>(t / (2 * kPi) * 48)];
  };
  EXPECT_GT(kappa_of(test::scattered(patchy, 60000, 0.02)), 10);
}

RC_GTEST_PROP(ErrorHistogram, QuantilesAreThoseOfTheSortedErrors, ()) {
  const auto errors = *rc::gen::container<std::vector<double>>(
      *rc::gen::inRange<std::size_t>(1, 400),
      rc::gen::map(rc::gen::inRange(-1000000, 1000000), [](int k) { return k * 1e-5; }));
  ErrorHistogram histogram;
  double square = 0;
  std::vector<double> sizes;
  for (const double e : errors) histogram.add(e), square += e * e, sizes.push_back(std::abs(e));
  std::sort(sizes.begin(), sizes.end());
  RC_ASSERT(histogram.count() == errors.size());
  RC_ASSERT(histogram.max() == sizes.back());
  RC_ASSERT(std::abs(histogram.rms() - std::sqrt(square / static_cast<double>(sizes.size()))) <= 1e-12);
  for (const double share : {0.05, 0.5, 0.95, 1.0}) {
    const auto at = static_cast<std::size_t>(std::ceil(share * static_cast<double>(sizes.size()))) - 1;
    RC_ASSERT(std::abs(histogram.quantile(share) - sizes[at]) <= 0.003 * sizes[at]);
  }
}

TEST(ErrorHistogram, EmptyAndExactStreamsAreZero) {
  ErrorHistogram histogram;
  EXPECT_EQ(histogram.quantile(0.95), 0);
  EXPECT_EQ(histogram.rms(), 0);
  for (int k = 0; k < 10; ++k) histogram.add(0);
  EXPECT_EQ(histogram.quantile(0.95), 0);
  EXPECT_EQ(histogram.max(), 0);
}

// Upper quantiles from printed tables of the normal distribution.
TEST(ModelSelection, NormalQuantilesAreThePrintedOnes) {
  EXPECT_NEAR(normal_quantile(0.025), 1.959963985, 1e-8);
  EXPECT_NEAR(normal_quantile(0.001), 3.090232306, 1e-8);
  EXPECT_NEAR(normal_quantile(1e-9), 5.997807015, 1e-7);
}

// Samples from 20 to 100 mm; a notch at the top between 1 and 2 rad down to 90, one sample astray at 5 mm.
struct Notched {
  MomentGrid sums{{0, 120, 32, 8, 3, 3}};
  SectorExtents extents{sums};
  Notched() {
    const BaseArcs arcs = BaseArcs::full_circle();
    for (int i = 0; i < 360; ++i)
      for (int j = 0; j <= 400; ++j) {
        const double theta = 2 * kPi * (i + 0.5) / 360, z = 20 + 80 * j / 400.0;
        if (theta > 1 && theta < 2 && z > 90) continue;
        add(arcs, theta, z);
      }
    add(arcs, 3, 5);
  }
  void add(const BaseArcs& arcs, double theta, double z) {
    const double r = 30;
    sums.add({&r, 1}, {&theta, 1}, {&z, 1});
    extents.add(arcs.v_of_theta(theta), z);
  }
};

TEST(Coverage, BandIsWhatEverySectorHas) {
  const Notched object;
  const CoveredBand band = find_covered_band(object.sums, &object.extents);
  EXPECT_DOUBLE_EQ(band.z_start_mm, 20);
  EXPECT_NEAR(band.z_end_mm, 90, 1e-9);
  EXPECT_NEAR(band.highest_mm, 100, 1e-9);
  EXPECT_DOUBLE_EQ(band.lowest_mm, 20) << "one stray sample is no object";
  EXPECT_EQ(band.cells.first, 5);
  EXPECT_EQ(band.cells.last, 24);
  EXPECT_EQ(band.sectors_with_samples, 16);
  const CoveredBand estimate = find_covered_band(object.sums, nullptr);
  EXPECT_NEAR(estimate.z_start_mm, 20, 0.3);
  EXPECT_NEAR(estimate.z_end_mm, 90, 0.3);
  EXPECT_DOUBLE_EQ(covered_share(object.sums, band), 1);
}

TEST(Coverage, EmptySectorsAreGapsAndShareIsTheirs) {
  MomentGrid sums({0, 120, 16, 8, 3, 3});
  for (int i = 0; i < 360; ++i)
    for (int j = 0; j <= 200; ++j) {
      const double theta = 2 * kPi * (i + 0.5) / 360, z = 120.0 * j / 200, r = 30;
      if (theta < kPi / 2) continue;
      sums.add({&r, 1}, {&theta, 1}, {&z, 1});
    }
  const CoveredBand band = find_covered_band(sums, nullptr);
  EXPECT_EQ(band.sectors_with_samples, 12);
  EXPECT_EQ(band.cells.first, 0);
  EXPECT_EQ(band.cells.last, 16);
  EXPECT_NEAR(covered_share(sums, band), 0.75, 0.02);
  EXPECT_EQ(find_covered_band(MomentGrid({0, 1, 4, 4, 3, 3}), nullptr).sectors_with_samples, 0);
}

}  // namespace
}  // namespace celadon
