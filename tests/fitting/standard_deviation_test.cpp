#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <random>
#include <set>

#include "fitting/block_cholesky.h"
#include "fitting/coefficient_covariance.h"
#include "fitting/deviation_map.h"
#include "fitting/knot_bias.h"
#include "fitting/local_variance.h"
#include "fitting/pole_solver.h"
#include "tests/fitting/coverage_scenarios.h"

namespace celadon {
namespace {

using test::dense;
using test::even_breaks;
using test::kPi;

// Scan rows: `profiles` lines of `rows` samples, with sums over a grid and a member of its ladder.
struct Scanned {
  test::MemoryStream stream;
  MomentGrid sums;
  FitLadder ladder;
  LadderFit member;
  std::vector<double> v, z;
  Scanned(const test::Shape& shape, const test::ScanSetting& setting, const GridSpecification& grid,
          LadderLevels levels, double smoothing = 0)
      : stream(test::scan(shape, setting)),
        sums(test::accumulate(stream, grid)),
        ladder(sums, {0, sums.z_cells()}, 3, 3, JointContinuity::curvature),
        member(*solve_member(ladder, levels, {})) {
    for (const Profile& p : stream.profiles)
      for (std::size_t k = 0; k < p.size(); ++k) {
        v.push_back(grid.arcs.v_of_theta(p.theta_rad[k]));
        z.push_back(p.z_mm[k]);
      }
    if (smoothing == 0) return;
    member.smoothing = smoothing;
    NormalSolver solver(*member.equations, smoothing);
    member.free = *solver.solve();
    member.parameters = solver.effective_parameters();
  }
};

double largest_difference(const StencilMatrix& entries, const Eigen::MatrixXd& expected) {
  double worst = 0;
  const int nu = entries.count_u();
  for (int j = 0; j < entries.count_v(); ++j)
    for (int o = 0; o < entries.planes_v(); ++o)
      for (int du = -entries.band_u(); du <= entries.band_u(); ++du)
        for (int i = std::max(0, -du); i < std::min(nu, nu - du); ++i)
          worst = std::max(worst, std::abs(entries.plane(o, du)[entries.at(i, j)] -
                                           expected(j * nu + i, entries.neighbour(j, o) * nu + i + du)));
  return worst;
}

// Every shape of block structure: long along u or around, a circle shorter than its own stencil, an open range, one
// function in a direction.
TEST(InverseEntries, AreThoseOfTheDenseInverse) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> share(0, 1);
  struct Case {
    int p, q, intervals, per_arc;
    bool open;
  };
  for (const Case& c : {Case{3, 3, 2, 8, false}, Case{3, 3, 16, 1, false}, Case{5, 3, 4, 2, false},
                        Case{3, 5, 2, 1, false}, Case{3, 0, 8, 1, false}, Case{0, 3, 1, 8, false},
                        Case{3, 3, 8, 4, true}, Case{2, 3, 2, 8, true}, Case{0, 0, 1, 1, false}}) {
    const BaseArcs arcs = c.open ? BaseArcs::open(0.2, 2.5) : BaseArcs::full_circle();
    MomentGrid grid({0, 120, 16, 8, 5, 5, arcs});
    for (int k = 0; k < 20000; ++k) {
      const double r = 30 + share(random), theta = 2 * kPi * share(random), z = 120 * share(random);
      grid.add({&r, 1}, {&theta, 1}, {&z, 1});
    }
    const double end = arcs.count();
    const NormalEquations equations(
        grid, {c.p ? RangeSpace::open(c.p, even_breaks(0, 120, c.intervals)) : RangeSpace::constant({0, 120}),
               c.q ? RangeSpace::over(c.q, arcs, c.per_arc) : RangeSpace::constant({0, end})});
    const Eigen::MatrixXd a = dense(equations.matrix()), inverse = a.inverse();
    const BlockCholesky factor(equations.matrix());
    ASSERT_TRUE(factor.ok());
    EXPECT_LT(largest_difference(factor.inverse_entries(), inverse), 1e-11 * inverse.cwiseAbs().maxCoeff())
        << c.p << ", " << c.q << ", " << c.intervals << " x " << c.per_arc;
  }
}

TEST(InverseEntries, BetweenClosedPolesAreThoseOfWhatTheJetsAllow) {
  std::mt19937_64 random(2);
  std::uniform_real_distribution<double> share(0, 1);
  GridSpecification specification{0, BaseSurface::kMeridianEnd, 16, 4, 3, 3};
  specification.base = BaseKind::sphere;
  MomentGrid grid(specification);
  for (int k = 0; k < 20000; ++k) {
    const double r = 30 + share(random), theta = 2 * kPi * share(random),
                 w = BaseSurface::meridian().v_of_theta(std::acos(1 - 2 * share(random)));
    grid.add({&r, 1}, {&theta, 1}, {&w, 1});
  }
  for (const Poles poles : {Poles{true, true}, Poles{true, false}, Poles{false, true}}) {
    const FitLadder ladder(grid, {0, 16, poles}, 3, 3, JointContinuity::curvature);
    const NormalEquations equations = ladder.equations(1, 0);
    const PoleJets& jets = *equations.jets();
    // P: unit vectors of the rows without a pole, then the jets' columns.
    const int nu = jets.count_u(), nv = jets.count_v();
    Eigen::MatrixXd p = Eigen::MatrixXd::Zero(nu * nv, jets.unknowns());
    int at = 0;
    for (int j = 0; j < nv; ++j)
      for (int i = jets.first_row(); i < jets.last_row(); ++i) p(j * nu + i, at++) = 1;
    for (int k = 0; k < jets.parameters(); ++k)
      p.col(at++) = Eigen::Map<const Eigen::VectorXd>(jets.column(k).data(), jets.column(k).size());
    const Eigen::MatrixXd m = dense(equations.matrix());
    const Eigen::MatrixXd inverse = p * (p.transpose() * m * p).inverse() * p.transpose();
    const PoleSolver solver(equations.matrix(), jets);
    ASSERT_TRUE(solver.ok());
    EXPECT_LT(largest_difference(solver.inverse_entries(), inverse), 1e-10 * inverse.cwiseAbs().maxCoeff());
  }
}

// The sandwich of the design matrix: every sample's own variance, errors common to profiles and a smoothing energy, all
// known, against the entries that follow from sums.
TEST(CoefficientCovariance, IsTheSandwichOfTheDesign) {
  const GridSpecification grid{0, 120, 8, 2, 3, 3};
  for (const double smoothing : {0.0, 1e-3})
    for (const double common : {0.0, 30.0}) {
      Scanned scanned([](double, double) { return 30.0; }, {.profiles = 60, .rows = 50, .sigma = 0.02}, grid, {1, 0},
                      smoothing);
      const NormalEquations& equations = *scanned.member.equations;
      const double variance = 4e-4;
      const Inflation inflation{2, common};
      const Eigen::MatrixXd b = test::design(equations.space(), scanned.v, scanned.z);
      // Errors of a profile: within sigma^2 on the diagonal and common sigma^2/rows everywhere.
      Eigen::MatrixXd scatter = inflation.within * variance * b.transpose() * b;
      for (Eigen::Index k = 0; k < b.rows(); k += 50) {
        const Eigen::RowVectorXd of_profile = b.middleRows(k, 50).colwise().sum();
        scatter += common * variance / 50 * of_profile.transpose() * of_profile;
      }
      Eigen::MatrixXd m = b.transpose() * b;
      if (smoothing > 0) {
        const BendingEnergy energy = bending_energy(equations);
        StencilMatrix e(equations.matrix().count_u(), 3, equations.matrix().count_v(), 3);
        energy.add_to(e, energy_factor(equations, energy, smoothing));
        const Eigen::MatrixXd bent = dense(e);
        m += bent;  // and the bending taken away, whose mean square the smoothing has assumed
        scatter += inflation.mean(scanned.member.parameters, equations.matrix().count_v()) * variance * bent;
      }
      const Eigen::MatrixXd expected = m.inverse() * scatter * m.inverse();
      const auto found = CoefficientCovariance::of(
          error_sources({scanned.sums, scanned.ladder, variance, inflation, 60, true}, std::move(scanned.member)));
      ASSERT_TRUE(found);
      const CoefficientCovariance& covariance = *found;
      const Eigen::MatrixXd places = test::design(covariance.space(), {0.1, 1.7, 3.99, 2.5}, {0, 33, 120, 77});
      const double v[] = {0.1, 1.7, 3.99, 2.5}, z[] = {0, 33, 120, 77};
      double sd[4];
      covariance.evaluate(v, z, 4, sd);
      for (int k = 0; k < 4; ++k)
        EXPECT_NEAR(sd[k] / std::sqrt(places.row(k) * expected * places.row(k).transpose()), 1, 2e-3)
            << "smoothing " << smoothing << ", common " << common << ", place " << k;
    }
}

// Where nothing was measured the energy alone decides: the deviation is many times that beside the hole.
TEST(CoefficientCovariance, GrowsWhereNothingWasSeen) {
  const auto scenarios = test::coverage_scenarios();
  const auto hole = std::find_if(scenarios.begin(), scenarios.end(), [](const auto& s) { return s.name == "hole"; });
  const auto fit = test::coverage_fit(*hole, 5);
  ASSERT_TRUE(fit);
  const BaseArcs arcs = BaseArcs::full_circle();
  const DeviationMap& map = *fit->deviation;
  EXPECT_GT(map(arcs.v_of_theta(1.4), 55), 10 * map(arcs.v_of_theta(4.5), 55));
  EXPECT_EQ(fit->report.sd_max_mm, map.largest());
  EXPECT_GT(fit->report.sd_max_mm, 10 * fit->report.sd_mean_mm);
}

TEST(CellResiduals, AreThoseOfTheSamples) {
  const GridSpecification grid{0, 120, 16, 4, 3, 3};
  Scanned scanned(test::freeform, {.profiles = 150, .rows = 120, .sigma = 0.02}, grid, {1, 1});
  const RangeFunction f = range_function(*scanned.member.equations, scanned.member.free);
  const CellResiduals residuals = cell_residuals(scanned.sums, *scanned.member.equations, scanned.member.free);
  Eigen::MatrixXd square = Eigen::MatrixXd::Zero(8, 8), count = square;
  std::size_t k = 0;
  for (const Profile& p : scanned.stream.profiles)
    for (std::size_t i = 0; i < p.size(); ++i, ++k) {
      const auto row = std::min<Eigen::Index>(7, static_cast<Eigen::Index>(scanned.z[k] / 15)),
                 column = static_cast<Eigen::Index>(scanned.v[k] * 2);
      square(row, column) += std::pow(p.r_mm[i] - f(p.theta_rad[i], p.z_mm[i]), 2);
      count(row, column) += 1;
    }
  EXPECT_EQ(residuals.weight, count);
  EXPECT_LT((residuals.square - square).cwiseAbs().maxCoeff(), 1e-9 * square.maxCoeff());
}

TEST(LocalVariance, FollowsTheNoise) {
  const GridSpecification grid{0, 120, 16, 8, 3, 3};
  test::MemoryStream stream = test::coverage_scan({.name = "", .profiles = 300, .rows = 300, .contrast = 5}, 3);
  const MomentGrid sums = test::accumulate(stream, grid);
  const FitLadder ladder(sums, {0, 16}, 3, 3, JointContinuity::curvature);
  const auto member = solve_member(ladder, {}, {});
  const Eigen::MatrixXd ratios = variance_ratios(cell_residuals(sums, *member->equations, member->free),
                                                 member->parameters, member->equations->mean_range());
  double mean = 0;
  for (int k = 0; k < 300; ++k)
    mean += std::pow(test::coverage_sigma({.name = "", .contrast = 5}, 2 * kPi * k / 300), 2) / 300;
  for (int j = 0; j < 32; ++j) {
    const double theta = grid.arcs.theta_of_v((j + 0.5) / 8);
    const double expected = std::pow(test::coverage_sigma({.name = "", .contrast = 5}, theta), 2) / mean;
    EXPECT_NEAR(ratios.col(j).mean() / expected, 1, 0.25) << theta;
  }
}

// Noise free, what the knots cannot follow is all there is of an error: the RMS over the surface, within a factor.
TEST(KnotBias, IsWhatTheKnotsMiss) {
  const GridSpecification grid{0, 120, 32, 16, 3, 3};
  for (const LadderLevels levels : {LadderLevels{1, 1}, LadderLevels{2, 1}, LadderLevels{2, 2}}) {
    Scanned scanned(test::freeform, {.profiles = 400, .rows = 200}, grid, levels);
    const LocalNoise none{0,
                          Eigen::MatrixXd::Ones(scanned.member.equations->space().u.intervals(),
                                                scanned.member.equations->space().v.intervals()),
                          {}};
    const Eigen::MatrixXd bias = knot_bias(scanned.ladder, scanned.sums, scanned.member, none, 400);
    const double missed =
        test::miss(range_function(*scanned.member.equations, scanned.member.free), test::freeform).rms;
    EXPECT_NEAR(std::sqrt(bias.array().square().mean()) / missed, 1, 0.15) << levels.u << ", " << levels.v;
  }
}

// The other way round: noise alone is not taken for what the knots miss.
TEST(KnotBias, IsSmallWhereTheKnotsFollow) {
  const GridSpecification grid{0, 120, 32, 16, 3, 3};
  for (unsigned seed = 1; seed <= 8; ++seed) {
    Scanned scanned([](double, double) { return 30.0; }, {.profiles = 200, .rows = 200, .sigma = 0.02, .seed = seed},
                    grid, {2, 2});
    const double scatter = 0.02 * std::sqrt(scanned.member.parameters / 40000);
    const LocalNoise noise{4e-4, Eigen::MatrixXd::Ones(8, 16), {}};
    const Eigen::MatrixXd bias = knot_bias(scanned.ladder, scanned.sums, scanned.member, noise, 200);
    EXPECT_LT(std::sqrt(bias.array().square().mean()), 0.6 * scatter) << seed;
  }
}

TEST(DeviationMap, IsBilinearAndClamped) {
  Eigen::MatrixXd sd(2, 3);
  sd << 1, 2, 3, 5, 6, 7;
  const DeviationMap map({10, 20}, {0, 1, 4}, sd);
  EXPECT_DOUBLE_EQ(map(0, 10), 1);
  EXPECT_DOUBLE_EQ(map(0.5, 15), 3.5);
  EXPECT_DOUBLE_EQ(map(4, 20), 7);
  EXPECT_DOUBLE_EQ(map(2.5, 10), 2.5);
  EXPECT_DOUBLE_EQ(map(9, 99), 7);
  EXPECT_DOUBLE_EQ(map(-1, -1), 1);
  EXPECT_EQ(map.largest(), 7);
  BaseSurface base;
  EXPECT_NEAR(DeviationMap({10, 20}, {0, 1, 4}, Eigen::MatrixXd::Constant(2, 3, 0.25)).mean(base), 0.25, 1e-15);
  base.kind = BaseKind::sphere;  // a cap up to 60 degrees, from 1 at its pole to 0: the mean of a line in cos(phi)
  const double w = BaseSurface::meridian().v_of_theta(kPi / 3);
  Eigen::MatrixXd falling(2, 2);
  falling << 1, 1, 0, 0;
  EXPECT_NEAR(DeviationMap({0, w}, {0, 4}, falling).mean(base), 0.5, 1e-15);
}

// At its nodes the map is the covariance to three digits, never below it; between them a few per cent off.
TEST(DeviationMap, HoldsWhatTheCovarianceSays) {
  for (const bool open : {false, true}) {
    test::CoverageScenario s{.name = "", .profiles = 150, .rows = 120, .correlation = 0.5, .open = open};
    const auto fit = test::coverage_fit(s, 3);
    ASSERT_TRUE(fit);
    const auto covariance = CoefficientCovariance::of(*fit->errors);
    ASSERT_TRUE(covariance);
    const DeviationMap& map = *fit->deviation;
    for (const double along : map.along())
      for (const double v : map.v()) {
        EXPECT_GE(map(v, along), covariance->sd_mm(v, along) * (1 - 1e-12));
        EXPECT_LE(map(v, along), covariance->sd_mm(v, along) * 1.0101);
      }
    double square = 0, worst = 0;
    std::mt19937_64 random(1);
    std::uniform_real_distribution<double> share(0, 1);
    for (int k = 0; k < 2000; ++k) {
      const double v = map.v().back() * share(random),
                   along = map.along().front() + (map.along().back() - map.along().front()) * share(random);
      const double off = map(v, along) / covariance->sd_mm(v, along) - 1;
      square += off * off / 2000;
      worst = std::max(worst, std::abs(off));
    }
    EXPECT_LT(std::sqrt(square), 0.04);
    EXPECT_LT(worst, 0.2);
  }
}

// A seeded sample of the campaign `coverage`, which counts 400 scans each.
TEST(StandardDeviation, AgreesWithWhatRepeatedScansMissTheTruthBy) {
  const std::set<std::string> names{"white", "AR 0.5 along the line", "noise 1:5 around", "noise 1:5, stated",
                                    "hole",  "open range, AR 0.5",    "sphere with poles"};
  for (const auto& scenario : test::coverage_scenarios()) {
    if (!names.contains(scenario.name)) continue;
    test::CoverageCount count(scenario);
    for (unsigned seed = 1; seed <= 5; ++seed) {
      const auto fit = test::coverage_fit(scenario, seed);
      ASSERT_TRUE(fit) << fit.error().message;
      ASSERT_TRUE(fit->deviation) << scenario.name;
      count.add(scenario, *fit);
    }
    const auto result = count.result(false);
    EXPECT_NEAR(result.stated / result.observed, 1, 0.15) << scenario.name;
    EXPECT_NEAR(result.covered, 0.95, 0.03) << scenario.name;
  }
}

}  // namespace
}  // namespace celadon
