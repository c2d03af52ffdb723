#include "fitting/moment_cells.h"

#include <gtest/gtest.h>
#include <numbers>

#include <cmath>
#include <random>
#include <vector>

#include "fitting/fit_ladder.h"

namespace celadon {
namespace {

using std::numbers::pi;
constexpr double kStart_mm = -7, kEnd_mm = 113, kLargest_mm = 40;

struct CellSamples {
  std::vector<double> r, theta, z;
};

CellSamples samples(unsigned seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> share(0, 1);
  CellSamples s;
  for (int k = 0; k < 3000; ++k) {
    s.theta.push_back(2 * pi * share(random));
    s.z.push_back(kStart_mm + (kEnd_mm - kStart_mm) * share(random));
    s.r.push_back(kLargest_mm * (1 + share(random)) / 2);
  }
  return s;
}

MomentGrid accumulate(const CellSamples& s, int z_intervals, int intervals_per_arc) {
  MomentGrid grid({kStart_mm, kEnd_mm, z_intervals, intervals_per_arc, 3, 3});
  grid.add(s.r, s.theta, s.z);
  return grid;
}

std::vector<int> every(int step, int cells) {
  std::vector<int> edges;
  for (int edge = 0; edge <= cells; edge += step) edges.push_back(edge);
  return edges;
}

// The other lanes only fill the vectors.
std::vector<int> meaningful(const MomentLayout& layout) {
  std::vector<int> lanes{layout.square()};
  for (int b = 0; b <= 2 * layout.degree_u; ++b)
    for (int a = 0; a <= 2 * layout.degree_v; ++a) lanes.push_back(layout.weight(b, a));
  for (int b = 0; b <= layout.degree_u; ++b)
    for (int a = 0; a <= layout.degree_v; ++a) lanes.push_back(layout.range(b, a));
  return lanes;
}

// The same samples summed straight into the larger cells.
TEST(MergedMoments, AreThoseOfTheLargerCells) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    const CellSamples s = samples(seed);
    const MomentGrid fine = accumulate(s, 32, 8), coarse = accumulate(s, 4, 2);
    const MergedMoments between(cells_of(fine), every(2, 32), every(1, 32));
    const MergedMoments merged(between.cells(), every(8, 32), every(4, 32));
    const MomentCells cells = merged.cells();
    ASSERT_EQ(cells.count_z(), coarse.z_cells());
    ASSERT_EQ(cells.count_v(), coarse.v_cells());
    for (int j = 0; j < coarse.v_cells(); ++j)
      for (int i = 0; i < coarse.z_cells(); ++i)
        for (const int at : meaningful(coarse.layout())) {
          const double size = kLargest_mm * coarse.cell_weight(i, j) + std::abs(coarse.cell(i, j)[at]);
          EXPECT_NEAR(cells.cell(i, j)[at], coarse.cell(i, j)[at], 1e-13 * size) << i << " " << j << " " << at;
        }
  }
}

// A band that begins and ends anywhere has cells of two sizes at its rims.
TEST(FitLadder, EquationsOfEveryLevelAreThoseOfTheGrid) {
  const MomentGrid grid = accumulate(samples(4), 32, 8);
  for (const CellBand band : {CellBand{0, 32}, CellBand{3, 29}, CellBand{1, 18}}) {
    const FitLadder ladder(grid, band, 3, 3, JointContinuity::curvature);
    for (int v = 0; v < ladder.levels_v(); ++v)
      for (int u = 0; u < ladder.levels_u(); ++u)
        for (const Variation variation : {Variation{true, true}, {true, false}, {false, true}, {false, false}}) {
          const NormalEquations merged = ladder.equations(u, v, variation);
          const NormalEquations direct(grid, ladder.space(u, v, variation));
          EXPECT_NEAR(merged.weight(), direct.weight(), 1e-12 * direct.weight());
          const Eigen::MatrixXd some =
              Eigen::MatrixXd::Random(direct.matrix().count_u(), direct.matrix().count_v()).array() + 30;
          EXPECT_NEAR(merged.quadratic(some), direct.quadratic(some), 1e-11 * direct.quadratic(some)) << u << " " << v;
          const Eigen::MatrixXd difference = merged.gradient(some) - direct.gradient(some);
          const double size = direct.gradient(Eigen::MatrixXd::Zero(some.rows(), some.cols())).cwiseAbs().maxCoeff();
          EXPECT_LE(difference.cwiseAbs().maxCoeff(), 1e-11 * size) << u << " " << v;
          EXPECT_EQ(merged.empty_cells() == 0, direct.empty_cells() == 0) << u << " " << v;
        }
  }
}

TEST(MergedMoments, RefuseEdgesThatTheCellsDoNotHave) {
  const MomentGrid grid = accumulate(samples(5), 8, 2);
  const MergedMoments pairs(cells_of(grid), every(2, 8), every(2, 8));
  EXPECT_THROW(MergedMoments(pairs.cells(), {0, 3, 8}, every(4, 8)), std::invalid_argument);
  EXPECT_THROW(MergedMoments(pairs.cells(), {0, 4, 4, 8}, every(4, 8)), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
