#include "fitting/moment_grid.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "tests/fitting/fit_tools.h"
#include "tests/fitting/simd_targets.h"

namespace celadon {
namespace {

using test::freeform;
using test::kPi;

struct Samples {
  std::vector<double> r, theta, z, weight;
};

Samples random_samples(std::size_t n, unsigned seed, double low = 0, double high = 120) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> share(0, 1);
  Samples s;
  for (std::size_t k = 0; k < n; ++k) {
    s.theta.push_back(2 * kPi * (3 * share(random) - 1));
    s.z.push_back(low + (high - low) * share(random));
    s.r.push_back(20 + 20 * share(random));
    s.weight.push_back(0.1 + share(random));
  }
  return s;
}

// The sums in long double, sample by sample, straight from their definition; largest relative difference.
double compare_with_definition(const MomentGrid& grid, const Samples& s, bool weighted) {
  const auto& spec = grid.specification();
  const int p = spec.degree_u, q = spec.degree_v;
  const MomentLayout layout = grid.layout();
  std::vector<long double> sums(static_cast<std::size_t>(grid.z_cells() * grid.v_cells() * layout.stride()), 0.0L);
  std::vector<long double> sizes(sums.size(), 0.0L);
  for (std::size_t k = 0; k < s.r.size(); ++k) {
    // eta = sin(xi/2)/(sin(xi/2) + sin((arc - xi)/2)) on each quarter of the circle.
    double turn = std::fmod(s.theta[k], 2 * kPi);
    if (turn < 0) turn += 2 * kPi;
    const int arc = std::min(3, static_cast<int>(turn / (kPi / 2)));
    const double xi = turn - arc * kPi / 2;
    const long double v =
        arc + std::sin(static_cast<long double>(xi) / 2) /
                  (std::sin(static_cast<long double>(xi) / 2) + std::sin(static_cast<long double>(kPi / 2 - xi) / 2));
    const long double x =
        (static_cast<long double>(s.z[k]) - spec.z_start_mm) * spec.z_intervals / (spec.z_end_mm - spec.z_start_mm);
    const long double y = v * spec.intervals_per_arc;
    const int i = std::min(static_cast<int>(x), grid.z_cells() - 1),
              j = std::min(static_cast<int>(y), grid.v_cells() - 1);
    const long double u = 2 * (x - i) - 1, t = 2 * (y - j) - 1, w = weighted ? s.weight[k] : 1;
    const auto base = static_cast<std::size_t>((j * grid.z_cells() + i) * layout.stride());
    const auto add = [&](int at, long double value) {
      sums[base + static_cast<std::size_t>(at)] += value;
      sizes[base + static_cast<std::size_t>(at)] += std::abs(value) + w;
    };
    for (int b = 0; b <= 2 * p; ++b)
      for (int a = 0; a <= 2 * q; ++a) add(layout.weight(b, a), w * std::pow(u, b) * std::pow(t, a));
    for (int b = 0; b <= p; ++b)
      for (int a = 0; a <= q; ++a) add(layout.range(b, a), w * s.r[k] * std::pow(u, b) * std::pow(t, a));
    add(layout.square(), w * s.r[k] * s.r[k]);
  }
  double worst = 0;
  for (int j = 0; j < grid.v_cells(); ++j)
    for (int i = 0; i < grid.z_cells(); ++i) {
      const double* cell = grid.cell(i, j);
      const auto base = static_cast<std::size_t>((j * grid.z_cells() + i) * layout.stride());
      const auto check = [&](int at) {
        const auto k = base + static_cast<std::size_t>(at);
        if (sizes[k] > 0)
          worst = std::max(worst, static_cast<double>(std::abs(cell[at] - sums[k]) / sizes[k]));
        else
          EXPECT_EQ(cell[at], 0.0);
      };
      for (int b = 0; b <= 2 * p; ++b)
        for (int a = 0; a <= 2 * q; ++a) check(layout.weight(b, a));
      for (int b = 0; b <= p; ++b)
        for (int a = 0; a <= q; ++a) check(layout.range(b, a));
      check(layout.square());
    }
  return worst;
}

// Everything that a cell's sums mean, for comparing two grids.
double largest_difference(const MomentGrid& a, const MomentGrid& b) {
  const MomentLayout layout = a.layout();
  double worst = 0;
  for (int j = 0; j < a.v_cells(); ++j)
    for (int i = 0; i < a.z_cells(); ++i) {
      const double *x = a.cell(i, j), *y = b.cell(i, j);
      const auto check = [&](int at, double size) { worst = std::max(worst, std::abs(x[at] - y[at]) / (1 + size)); };
      for (int r = 0; r < layout.weight_rows(); ++r)
        for (int c = 0; c <= 2 * layout.degree_v; ++c) check(layout.weight(r, c), y[0]);
      for (int r = 0; r < layout.range_rows(); ++r)
        for (int c = 0; c <= layout.degree_v; ++c) check(layout.range(r, c), y[layout.range(0, 0)]);
      check(layout.square(), y[layout.square()]);
    }
  return worst;
}

TEST(MomentGrid, HoldsTheMomentsOfItsDefinitionForAllDegrees) {
  const Samples s = random_samples(1500, 1);
  for (int p = 1; p <= 5; ++p)
    for (int q = 1; q <= 5; ++q)
      for (const bool weighted : {false, true}) {
        MomentGrid grid({0, 120, 4, 2, p, q});
        grid.add(s.r, s.theta, s.z, weighted ? std::span<const double>(s.weight) : std::span<const double>());
        EXPECT_EQ(grid.samples(), s.r.size());
        EXPECT_LT(compare_with_definition(grid, s, weighted), 2e-14) << "degrees " << p << ", " << q;
      }
}

TEST(MomentGrid, EveryWayOfAddingGivesTheSameSums) {
  for (int p = 1; p <= 5; ++p) {
    const GridSpecification spec{-10, 100, 8, 4, p, p};
    MomentGrid general(spec), constant(spec), cartesian(spec), regular(spec);
    constexpr int kRows = 37, kColumns = 101;
    Eigen::Matrix<double, -1, -1, Eigen::RowMajor> r(kRows, kColumns);
    std::vector<double> z(kColumns);
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> share(0, 1);
    for (int j = 0; j < kColumns; ++j)
      z[static_cast<std::size_t>(j)] = -25 + 140 * share(random);  // in no order, some outside
    for (int i = 0; i < kRows; ++i) {
      const double theta = 2 * kPi * (i + 0.3) / kRows;
      std::vector<double> line(kColumns), angle(kColumns, theta), x(kColumns), y(kColumns);
      for (int j = 0; j < kColumns; ++j) {
        const auto k = static_cast<std::size_t>(j);
        line[k] = r(i, j) = freeform(theta, z[k]);
        x[k] = line[k] * std::cos(theta);
        y[k] = line[k] * std::sin(theta);
      }
      general.add(line, angle, z);
      constant.add_constant_theta(theta, line, z);
      cartesian.add_cartesian(x, y, z);
    }
    regular.add_regular(r, 0.3, z);
    for (const MomentGrid* other : {&constant, &cartesian, &regular}) {
      EXPECT_EQ(other->samples(), general.samples());
      EXPECT_EQ(other->rejected(), general.rejected());
      EXPECT_EQ(other->rejected_outside(), general.rejected_outside());
      EXPECT_LT(largest_difference(*other, general), 1e-13) << "degree " << p;
    }
    EXPECT_GT(general.rejected_outside(), 0u);
  }
}

TEST(MomentGrid, BadSamplesAreCountedByReasonAndNeverAdded) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
  const Samples good = random_samples(200, 3);
  const GridSpecification spec{0, 120, 4, 4, 3, 3};
  MomentGrid clean(spec);
  clean.add(good.r, good.theta, good.z);
  Samples mixed;
  const auto push = [&](double r, double theta, double z) {
    mixed.r.push_back(r);
    mixed.theta.push_back(theta);
    mixed.z.push_back(z);
  };
  for (std::size_t k = 0; k < good.r.size(); ++k) {
    push(good.r[k], good.theta[k], good.z[k]);
    if (k % 8 == 0)
      push(nan, 1, 1), push(inf, 1, 1), push(30, nan, 1), push(30, inf, 1), push(30, 1, nan), push(30, 1, -inf);
    if (k % 8 == 1) push(0, 1, 1), push(-3, 1, 1);
    if (k % 8 == 2) push(30, 1, -0.001), push(30, 1, 120.001), push(30, 1, 1e300);
  }
  MomentGrid grid(spec);
  grid.add(mixed.r, mixed.theta, mixed.z);
  EXPECT_EQ(grid.samples(), 200u);
  EXPECT_EQ(grid.rejected_not_finite(), 6 * 25u);
  EXPECT_EQ(grid.rejected_on_axis(), 2 * 25u);
  EXPECT_EQ(grid.rejected_outside(), 3 * 25u);
  EXPECT_LT(largest_difference(grid, clean), 1e-14);

  // Both ends of the band belong to it; a weight that is no positive number does not count.
  MomentGrid ends(spec);
  ends.add(std::vector<double>{30, 30, 30, 30, 30}, std::vector<double>{0, 0, 0, 0, 0},
           std::vector<double>{0, 120, 5, 5, 5}, std::vector<double>{1, 1, 0, nan, -1});
  EXPECT_EQ(ends.samples(), 2u);
  EXPECT_EQ(ends.rejected_not_finite(), 3u);

  // In lines and grids a bad value costs itself alone.
  MomentGrid lines(spec), regular(spec);
  const std::vector<double> z{1, 31, 61, 91, 92, 93, 94, 95};
  Eigen::Matrix<double, -1, -1, Eigen::RowMajor> r(3, 8);
  r.setConstant(30);
  r(1, 2) = nan, r(1, 6) = -1, r(2, 7) = inf;
  for (int i = 0; i < 3; ++i) lines.add_constant_theta(2 * kPi * i / 3, {r.row(i).data(), 8}, z);
  regular.add_regular(r, 0, z);
  EXPECT_EQ(lines.samples(), 21u);
  EXPECT_EQ(lines.rejected(), 3u);
  EXPECT_EQ(regular.samples(), 21u);
  EXPECT_EQ(regular.rejected(), 3u);
  EXPECT_LT(largest_difference(lines, regular), 1e-14);
  MomentGrid nowhere(spec);
  nowhere.add_constant_theta(nan, std::vector<double>{30, 30}, std::vector<double>{1, 2});
  EXPECT_EQ(nowhere.rejected(), 2u);
}

TEST(MomentGrid, MergedPartsEqualTheWhole) {
  const Samples s = random_samples(4000, 9);
  const GridSpecification spec{0, 120, 8, 4, 3, 3};
  MomentGrid whole(spec), a(spec), b(spec);
  whole.add(s.r, s.theta, s.z);
  a.add(std::span(s.r).first(1700), std::span(s.theta).first(1700), std::span(s.z).first(1700));
  b.add(std::span(s.r).subspan(1700), std::span(s.theta).subspan(1700), std::span(s.z).subspan(1700));
  a.merge(b);
  EXPECT_EQ(a.samples(), whole.samples());
  EXPECT_LT(largest_difference(a, whole), 1e-14);
}

TEST(MomentGrid, MergingDifferentSumsNamesWhatDiffers) {
  const GridSpecification spec{0, 120, 8, 4, 3, 3};
  const auto message = [&](const MomentGrid& other) {
    MomentGrid grid(spec);
    try {
      grid.merge(other);
    } catch (const std::invalid_argument& e) {
      return std::string(e.what());
    }
    return std::string("merged");
  };
  auto band = spec, intervals = spec, degrees = spec;
  band.z_end_mm = 121, intervals.intervals_per_arc = 8, degrees.degree_u = 2;
  EXPECT_THAT(message(MomentGrid(band)), testing::HasSubstr("band"));
  EXPECT_THAT(message(MomentGrid(intervals)), testing::HasSubstr("intervals"));
  EXPECT_THAT(message(MomentGrid(degrees)), testing::HasSubstr("degrees"));
  EXPECT_THAT(message(MomentGrid(spec, WeightRule::covariance)), testing::HasSubstr("weight rule"));
  EXPECT_EQ(message(MomentGrid(spec)), "merged");
}

TEST(MomentGrid, RefusesWhatIsNoGrid) {
  EXPECT_THROW(MomentGrid({0, 0, 8, 4, 3, 3}), std::invalid_argument);
  EXPECT_THROW(MomentGrid({0, std::nan(""), 8, 4, 3, 3}), std::invalid_argument);
  EXPECT_THROW(MomentGrid({0, 1, 12, 4, 3, 3}), std::invalid_argument);
  EXPECT_THROW(MomentGrid({0, 1, 8, 0, 3, 3}), std::invalid_argument);
  EXPECT_THROW(MomentGrid({0, 1, 8, 4, 6, 3}), std::invalid_argument);
  EXPECT_THROW(MomentGrid({0, 1, 8, 4, 3, 0}), std::invalid_argument);
  MomentGrid grid({0, 1, 8, 4, 3, 3});
  EXPECT_THROW(grid.add(std::vector<double>{1}, std::vector<double>{1, 2}, std::vector<double>{1}),
               std::invalid_argument);
}

TEST(MomentGrid, EveryInstructionSetOfThisMachineAgrees) {
  const Samples s = random_samples(3000, 11);
  const GridSpecification spec{0, 120, 8, 4, 3, 3}, odd{0, 120, 8, 4, 4, 2};
  const auto all = [&](const GridSpecification& g) {
    MomentGrid grid(g);
    grid.add(s.r, s.theta, s.z, s.weight);
    grid.add_cartesian(s.r, s.theta, s.z);
    grid.add_constant_theta(1, s.r, s.z);
    return grid;
  };
  const MomentGrid best = all(spec), best_odd = all(odd);
  test::at_every_simd_level([&] {
    EXPECT_LT(largest_difference(all(spec), best), 1e-13);
    EXPECT_LT(largest_difference(all(odd), best_odd), 1e-13);
  });
}

TEST(MomentGrid, MemoryIsThatOfTheCellsAlone) {
  MomentGrid grid({0, 120, 32, 16, 3, 3});  // 64 x 32
  const std::size_t before = grid.memory_bytes();
  EXPECT_LT(before, 1'300'000u);
  for (unsigned k = 0; k < 20; ++k) {
    const Samples s = random_samples(5000, k);
    grid.add(s.r, s.theta, s.z);
  }
  EXPECT_EQ(grid.memory_bytes(), before);
}

}  // namespace
}  // namespace celadon
