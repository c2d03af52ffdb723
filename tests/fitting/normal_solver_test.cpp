#include "fitting/normal_solver.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <random>

#include "fitting/banded_cholesky.h"
#include "fitting/block_cholesky.h"
#include "fitting/dense_product.h"
#include "fitting/fit_ladder.h"
#include "fitting/knot_selection.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::dense;
using test::even_breaks;
using test::freeform;
using test::kPi;

struct Cloud {
  std::vector<double> r, theta, v, z;
};

Cloud random_cloud(int n, unsigned seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> share(0, 1);
  std::normal_distribution<double> normal;
  Cloud c;
  const BaseArcs arcs = BaseArcs::full_circle();
  for (int k = 0; k < n; ++k) {
    c.theta.push_back(2 * kPi * share(random));
    c.z.push_back(120 * share(random));
    c.r.push_back(freeform(c.theta.back(), c.z.back()) + 0.1 * normal(random));
    c.v.push_back(arcs.v_of_theta(c.theta.back()));
  }
  return c;
}

FitSpace space(int p, int q, int intervals, int per_arc, JointContinuity continuity = JointContinuity::curvature) {
  return {p == 0 ? RangeSpace::constant({0, 120}) : RangeSpace::open(p, even_breaks(0, 120, intervals)),
          q == 0 ? RangeSpace::constant({0, 4}) : RangeSpace::over(q, BaseArcs::full_circle(), per_arc, continuity)};
}

// Against least squares on the samples themselves: QR of the design matrix, its basis by Cox - de Boor.
TEST(NormalEquations, GiveTheLeastSquaresFitOfTheSamples) {
  const Cloud c = random_cloud(900, 2);
  const Eigen::Map<const Eigen::VectorXd> r(c.r.data(), static_cast<Eigen::Index>(c.r.size()));
  for (int p = 0; p <= 5; ++p)
    for (int q = 0; q <= 5; ++q)
      for (const auto continuity : {JointContinuity::curvature, JointContinuity::thesis}) {
        MomentGrid grid({0, 120, 4, 2, std::max(p, 1), std::max(q, 1)});
        grid.add(c.r, c.theta, c.z);
        const FitSpace s = space(p, q, 2, 2, continuity);
        const NormalEquations equations(grid, s);
        const auto free = NormalSolver(equations).solve();
        ASSERT_TRUE(free) << p << ", " << q;
        const Eigen::MatrixXd rows = test::design(s, c.v, c.z);
        const Eigen::VectorXd x = rows.colPivHouseholderQr().solve(r);
        const Eigen::Map<const Eigen::VectorXd> found(free->data(), free->size());
        EXPECT_LT((rows * (found - x)).cwiseAbs().maxCoeff(), 2e-9) << p << ", " << q;
        const double rss = (r - rows * x).squaredNorm();
        EXPECT_NEAR(equations.residual_square(*free), rss, 1e-9 * rss) << p << ", " << q;
      }
}

TEST(NormalEquations, MatrixIsThatOfTheDesign) {
  const Cloud c = random_cloud(700, 3);
  const Eigen::Map<const Eigen::VectorXd> r(c.r.data(), static_cast<Eigen::Index>(c.r.size()));
  MomentGrid grid({0, 120, 8, 4, 3, 3});
  grid.add(c.r, c.theta, c.z);
  for (const int per_arc : {1, 2, 4}) {
    const FitSpace s = space(3, 3, 8, per_arc);
    const NormalEquations equations(grid, s);
    const Eigen::MatrixXd rows = test::design(s, c.v, c.z), expected = rows.transpose() * rows;
    EXPECT_LT((dense(equations.matrix()) - expected).cwiseAbs().maxCoeff(), 1e-13 * expected.maxCoeff()) << per_arc;
    const Eigen::VectorXd b = rows.transpose() * r;
    const Eigen::MatrixXd zero = Eigen::MatrixXd::Zero(s.u.free_count(), s.v.free_count());
    const Eigen::MatrixXd found = equations.gradient(zero);
    EXPECT_LT((Eigen::Map<const Eigen::VectorXd>(found.data(), found.size()) - b).cwiseAbs().maxCoeff(),
              1e-13 * b.maxCoeff());
  }
}

// A_coarse = K' A_fine K: coarse spaces taken from fine sums against coarse sums of the same samples.
TEST(NormalEquations, RestrictionToCoarserAndSimplerSpacesIsExact) {
  const Cloud c = random_cloud(5000, 4);
  MomentGrid fine({0, 120, 32, 16, 3, 3});
  fine.add(c.r, c.theta, c.z);
  const auto compare = [&](const GridSpecification& spec, const FitSpace& s) {
    MomentGrid coarse(spec);
    coarse.add(c.r, c.theta, c.z);
    const Eigen::MatrixXd a = dense(NormalEquations(fine, s).matrix()), b = dense(NormalEquations(coarse, s).matrix());
    return (a - b).cwiseAbs().maxCoeff() / b.cwiseAbs().maxCoeff();
  };
  EXPECT_LT(compare({0, 120, 4, 2, 3, 3}, space(3, 3, 4, 2)), 2e-15);
  EXPECT_LT(compare({0, 120, 8, 1, 3, 3}, space(3, 3, 8, 1)), 2e-15);
  EXPECT_LT(compare({0, 120, 8, 1, 3, 3}, space(3, 0, 8, 1)), 2e-15);
  EXPECT_LT(compare({0, 120, 1, 4, 3, 3}, space(0, 3, 1, 4)), 2e-15);
  EXPECT_LT(compare({0, 120, 1, 1, 3, 3}, space(0, 0, 1, 1)), 2e-15);
}

TEST(NormalEquations, BreaksOffTheGridAreAProgrammersError) {
  const MomentGrid grid({0, 120, 8, 4, 3, 3});
  EXPECT_THROW(NormalEquations(grid, space(3, 3, 5, 4)), std::invalid_argument);
  EXPECT_THROW(NormalEquations(grid, space(3, 3, 8, 8)), std::invalid_argument);
  EXPECT_THROW(NormalEquations(grid, space(4, 3, 8, 4)), std::invalid_argument);
}

TEST(NormalSolver, IterationFactorAndDenseSolutionAgree) {
  const Cloud c = random_cloud(40000, 5);
  MomentGrid grid({0, 120, 16, 8, 5, 5});
  grid.add(c.r, c.theta, c.z);
  struct Case {
    int p, q, intervals, per_arc;
  };
  for (const Case& k : {Case{3, 3, 16, 8}, Case{5, 5, 16, 4}, Case{3, 3, 16, 1}, Case{2, 4, 2, 8}, Case{1, 1, 16, 8}}) {
    const NormalEquations equations(grid, space(k.p, k.q, k.intervals, k.per_arc));
    for (const double smoothing : {0.0, 1e-6, 1e-3}) {
      NormalSolver iteration(equations, smoothing, {.tolerance = 1e-12, .max_iterations = 400});
      NormalSolver direct(equations, smoothing, {.direct = true});
      const auto x = iteration.solve(), y = direct.solve();
      ASSERT_TRUE(x && y);
      EXPECT_TRUE(direct.direct());
      StencilMatrix system = equations.matrix();
      if (smoothing > 0) {
        const BendingEnergy energy = bending_energy(equations);
        energy.add_to(system, smoothing * dense(equations.matrix()).trace() / energy.trace());
      }
      const auto& rhs = equations.right_hand_side();
      Eigen::VectorXd b(system.size());
      for (int i = 0; i < system.size(); ++i) b(i) = rhs[system.at(i % system.count_u(), i / system.count_u())];
      const Eigen::VectorXd z = dense(system).ldlt().solve(b);
      EXPECT_LT((Eigen::Map<const Eigen::VectorXd>(y->data(), y->size()) - z).cwiseAbs().maxCoeff(), 1e-8);
      EXPECT_LT((*x - *y).cwiseAbs().maxCoeff(), 1e-8);
    }
  }
}

TEST(NormalSolver, IterationIsTheUsualWayAndTakesFewSteps) {
  const Cloud c = random_cloud(200000, 6);
  MomentGrid grid({0, 120, 32, 16, 3, 3});
  grid.add(c.r, c.theta, c.z);
  const NormalEquations equations(grid, space(3, 3, 32, 16));
  NormalSolver solver(equations);
  ASSERT_TRUE(solver.solve());
  EXPECT_FALSE(solver.direct());
  EXPECT_LE(solver.iterations(), 20);
}

// Where the density is a product of one along z and one around, so is the matrix, and the preconditioner is its
// inverse.
TEST(NormalSolver, AProductOfDensitiesTakesTwoSteps) {
  Cloud c;
  for (int i = 0; i < 400; ++i)
    for (int j = 0; j < 150; ++j) {
      const double share = i / 400.0;
      c.theta.push_back(2 * test::kPi * (share + 0.1 * std::sin(2 * test::kPi * share)));
      c.z.push_back(120 * std::pow((j + 0.5) / 150, 1.5));
      c.r.push_back(test::freeform(c.theta.back(), c.z.back()));
    }
  MomentGrid grid({0, 120, 32, 16, 3, 3});
  grid.add(c.r, c.theta, c.z);
  const NormalEquations equations(grid, space(3, 3, 32, 16));
  NormalSolver solver(equations);
  const auto x = solver.solve();
  ASSERT_TRUE(x);
  EXPECT_FALSE(solver.direct());
  EXPECT_LE(solver.iterations(), 2);
  NormalSolver direct(equations, 0, {.direct = true});
  EXPECT_LT((*x - *direct.solve()).cwiseAbs().maxCoeff(), 1e-9);
}

TEST(NormalSolver, FewSamplesAnUnknownGoToTheDirectFactor) {
  const Cloud c = random_cloud(10000, 16);
  MomentGrid grid({0, 120, 32, 16, 3, 3});
  grid.add(c.r, c.theta, c.z);
  const NormalEquations equations(grid, space(3, 3, 32, 16));
  NormalSolver solver(equations);
  ASSERT_TRUE(solver.solve());
  EXPECT_TRUE(solver.direct());
}

TEST(DenseProduct, AddsTheProductAtEveryShape) {
  std::mt19937_64 random(4);
  std::uniform_real_distribution<double> share(-1, 1);
  const auto matrix = [&](int rows, int columns) {
    Eigen::MatrixXd m(rows, columns);
    for (auto& x : m.reshaped()) x = share(random);
    return m;
  };
  for (const int rows : {1, 4, 7, 12, 23, 35})
    for (const int columns : {1, 3, 4, 9, 34})
      for (const int inner : {1, 5, 35}) {
        const Eigen::MatrixXd a = with_padded_rows(matrix(rows, inner)),
                              start = with_padded_rows(matrix(rows, columns));
        const Eigen::MatrixXd b = matrix(inner + 1, columns), transposed = matrix(columns + 2, inner);
        Eigen::MatrixXd plain = start, turned = start;
        add_product(-0.5, a, b, plain);
        add_transposed_product(2, a, transposed, turned);
        for (int i = 0; i < start.rows(); ++i)
          for (int j = 0; j < columns; ++j) {
            long double expected = 0, expected_turned = 0;
            for (int k = 0; k < inner; ++k) {
              expected += static_cast<long double>(a(i, k)) * b(k, j);
              expected_turned += static_cast<long double>(a(i, k)) * transposed(j, k);
            }
            EXPECT_NEAR(plain(i, j), static_cast<double>(start(i, j) - 0.5L * expected), 1e-14);
            EXPECT_NEAR(turned(i, j), static_cast<double>(start(i, j) + 2 * expected_turned), 1e-14);
          }
      }
}

TEST(NormalSolver, FallsBackWhenTheIterationDoesNotConverge) {
  const Cloud c = random_cloud(40000, 7);
  MomentGrid grid({0, 120, 16, 8, 3, 3});
  grid.add(c.r, c.theta, c.z);
  const NormalEquations equations(grid, space(3, 3, 16, 8));
  NormalSolver solver(equations, 0, {.tolerance = 1e-12, .max_iterations = 1});
  NormalSolver usual(equations);
  const auto x = solver.solve(), y = usual.solve();
  ASSERT_TRUE(x && y);
  EXPECT_TRUE(solver.direct());
  EXPECT_LT((*x - *y).cwiseAbs().maxCoeff(), 1e-8);
}

TEST(NormalSolver, EmptyCellsAreBridgedWithoutTouchingTheRest) {
  Cloud c = random_cloud(60000, 8), kept;
  for (std::size_t k = 0; k < c.r.size(); ++k) {
    if (c.theta[k] > 1 && c.theta[k] < 2.2 && c.z[k] > 30 && c.z[k] < 90) continue;
    kept.r.push_back(c.r[k]), kept.theta.push_back(c.theta[k]), kept.z.push_back(c.z[k]), kept.v.push_back(c.v[k]);
  }
  MomentGrid grid({0, 120, 16, 8, 3, 3});
  grid.add(kept.r, kept.theta, kept.z);
  const FitLadder ladder(grid, {0, 16}, 3, 3, JointContinuity::curvature);
  const auto fit = solve_member(ladder, {0, 0}, {});
  ASSERT_TRUE(fit);
  EXPECT_GT(fit->equations->empty_cells(), 0);
  // The gradient vanishes: on the samples it is plain least squares.
  EXPECT_LT(fit->equations->gradient(fit->free).cwiseAbs().maxCoeff(), 1e-4);
  // In the gap the surface stays within what surrounds it.
  const RangeFunction f = range_function(*fit->equations, fit->free);
  EXPECT_LT(std::abs(f(1.6, 60) - freeform(1.6, 60)), 3);
}

TEST(NormalSolver, EffectiveParametersAreTheTrace) {
  const Cloud c = random_cloud(9000, 9);
  MomentGrid grid({0, 120, 16, 4, 3, 3});
  grid.add(c.r, c.theta, c.z);
  for (const int per_arc : {2, 4}) {
    const NormalEquations equations(grid, space(3, 3, 16, per_arc));
    for (const double smoothing : {1e-5, 1e-3}) {
      const Eigen::MatrixXd a = dense(equations.matrix());
      StencilMatrix system = equations.matrix();
      const BendingEnergy energy = bending_energy(equations);
      energy.add_to(system, smoothing * a.trace() / energy.trace());
      const double exact = dense(system).ldlt().solve(a).trace();
      NormalSolver solver(equations, smoothing);
      const double estimate = solver.effective_parameters(), unknowns = equations.matrix().size();
      EXPECT_NEAR(estimate, exact, 0.06 * exact);
      EXPECT_NEAR(unknowns - estimate, unknowns - exact, 0.1 * (unknowns - exact)) << "what smoothing takes away";
    }
  }
}

// Random bands with and without corners, against a dense factor.
TEST(BandedCholesky, IsTheDenseInverse) {
  for (const int n : {7, 30, 200})
    for (const bool closed : {false, true}) {
      const int band = 3;
      Eigen::MatrixXd g = Eigen::MatrixXd::Zero(n, n);
      for (int i = 0; i < n; ++i)
        for (int d = 0; d <= band; ++d) {
          const int j = closed ? (i + d) % n : i + d;
          if (j >= n) continue;
          g(i, j) = g(j, i) = d == 0 ? 2 : 1.0 / (d + 2 + (i % 3));
        }
      g.diagonal().array() += 2;
      const BandedCholesky factor(g, band);
      ASSERT_TRUE(factor.ok());
      const Eigen::MatrixXd x = Eigen::MatrixXd::Random(5, n);
      Eigen::MatrixXd y = x;
      factor.divide(y);
      EXPECT_LT((y * g - x).cwiseAbs().maxCoeff(), 1e-13) << n << closed;
    }
  EXPECT_FALSE(BandedCholesky(-Eigen::MatrixXd::Identity(5, 5), 1).ok());
}

}  // namespace
}  // namespace celadon
