#include "fitting/regular_grid.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "tests/fitting/fit_tools.h"
#include "tests/fitting/simd_targets.h"

namespace celadon {
namespace {

using test::even_breaks;
using test::kPi;
using Ranges = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr double kOffsetRows = 0.3;

std::vector<double> uneven_heights(int columns, unsigned seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> share(0, 1);
  std::vector<double> z(static_cast<std::size_t>(columns));
  for (double& height : z) height = 120 * share(random);
  return z;
}

Ranges noisy_ranges(int rows, const std::vector<double>& z, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> noise(0, 0.1);
  Ranges r(rows, static_cast<Eigen::Index>(z.size()));
  for (int i = 0; i < rows; ++i)
    for (int j = 0; j < r.cols(); ++j)
      r(i, j) = test::freeform(2 * kPi * (i + kOffsetRows) / rows, z[static_cast<std::size_t>(j)]) + noise(random);
  return r;
}

FitSpace cylinder_space(int p, int q, int intervals, int per_arc) {
  return {p == 0 ? RangeSpace::constant({0, 120}) : RangeSpace::open(p, even_breaks(0, 120, intervals)),
          q == 0 ? RangeSpace::constant({0, 4})
                 : RangeSpace::over(q, BaseArcs::full_circle(), per_arc, JointContinuity::curvature)};
}

// Against QR of the design matrix, its basis by Cox - de Boor: every degree, heights in no order, more rows to an
// interval than are summed in one go.
TEST(RegularGrid, GivesTheLeastSquaresFitOfItsSamples) {
  const BaseArcs arcs = BaseArcs::full_circle();
  for (int p = 0; p <= 5; ++p)
    for (int q = 0; q <= 5; ++q) {
      SCOPED_TRACE(testing::Message() << "degrees " << p << ", " << q);
      const std::vector<double> z = uneven_heights(37, 3);
      const Ranges r = noisy_ranges(q == 0 ? 50 : 45, z, 4);
      const FitSpace space = cylinder_space(p, q, 2, 2);
      std::vector<double> each_v, each_z;
      Eigen::VectorXd each_r(r.size());
      for (int i = 0; i < r.rows(); ++i)
        for (int j = 0; j < r.cols(); ++j) {
          each_r(static_cast<Eigen::Index>(each_v.size())) = r(i, j);
          each_v.push_back(arcs.v_of_theta(2 * kPi * (i + kOffsetRows) / static_cast<double>(r.rows())));
          each_z.push_back(z[static_cast<std::size_t>(j)]);
        }
      const Eigen::MatrixXd design = test::design(space, each_v, each_z);
      const Eigen::VectorXd fitted = design * design.colPivHouseholderQr().solve(each_r);
      test::at_every_simd_level([&] {
        const auto f = fit_regular_grid(space, arcs, r, kOffsetRows, z);
        ASSERT_TRUE(f);
        double miss = 0;
        for (std::size_t k = 0; k < each_v.size(); ++k) {
          const double there = (*f)(arcs.theta_of_v(each_v[k]), each_z[k]);
          miss = std::max(miss, std::abs(there - fitted(static_cast<Eigen::Index>(k))));
        }
        EXPECT_LT(miss, 1e-9);
      });
    }
}

TEST(RegularGrid, IsExactOnAMemberOfItsSpace) {
  const FitSpace space = cylinder_space(3, 2, 5, 1);
  std::vector<double> z;
  for (int j = 0; j < 200; ++j) z.push_back(120.0 * j / 199);
  Ranges r(100, 200);
  const auto profile = [](double height) { return 20 + 1e-5 * height * height * (150 - height); };
  for (int i = 0; i < 100; ++i)
    for (int j = 0; j < 200; ++j) r(i, j) = profile(z[static_cast<std::size_t>(j)]);
  const auto f = fit_regular_grid(space, BaseArcs::full_circle(), r, 0, z);
  ASSERT_TRUE(f);
  for (double theta = 0; theta < 6; theta += 0.7)
    for (double height = 0; height <= 120; height += 7) EXPECT_NEAR((*f)(theta, height), profile(height), 1e-11);
}

TEST(RegularGrid, SaysWhenTheSamplesDoNotDetermineTheSurface) {
  const FitSpace space = cylinder_space(3, 3, 8, 4);
  const std::vector<double> few_z{10, 20, 30, 40}, many_z = uneven_heights(100, 5);
  EXPECT_FALSE(fit_regular_grid(space, BaseArcs::full_circle(), noisy_ranges(100, few_z, 6), 0, few_z));
  EXPECT_FALSE(fit_regular_grid(space, BaseArcs::full_circle(), noisy_ranges(5, many_z, 6), 0, many_z));
  EXPECT_FALSE(fit_regular_grid(space, BaseArcs::full_circle(), Ranges(0, 100), 0, many_z));
}

TEST(RegularGrid, RefusesWhatIsNoCompleteGridByPlaceAndValue) {
  const FitSpace space = cylinder_space(3, 3, 2, 2);
  const std::vector<double> z = uneven_heights(40, 7);
  const auto refusal = [&](Ranges r, std::vector<double> heights, const BaseArcs& arcs) -> std::string {
    try {
      fit_regular_grid(space, arcs, r, 0, heights);
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "";
  };
  const BaseArcs circle = BaseArcs::full_circle();
  Ranges r = noisy_ranges(50, z, 8);
  EXPECT_EQ(refusal(r, z, circle), "");
  r(31, 7) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(refusal(r, z, circle), testing::HasSubstr("row 31, column 7 is nan"));
  r(31, 7) = -2;
  EXPECT_THAT(refusal(r, z, circle), testing::HasSubstr("row 31, column 7 is -2"));
  r(31, 7) = 30;
  std::vector<double> heights = z;
  heights[3] = 121;
  EXPECT_THAT(refusal(r, heights, circle), testing::HasSubstr("column 3 is at z = 121 mm"));
  heights.pop_back();
  EXPECT_THAT(refusal(r, heights, circle), testing::HasSubstr("39 heights are given for 40 columns"));
  EXPECT_THAT(refusal(r, z, BaseArcs::open(0, 3)), testing::HasSubstr("open"));
}

}  // namespace
}  // namespace celadon
