#include "fitting/range_space.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <numbers>

#include <Eigen/Dense>
#include <fstream>
#include <random>
#include <set>

#include "fitting/bspline_basis.h"
#include "tests/build_paths.h"
#include "tests/fitting/spline_tools.h"

namespace celadon {
namespace {

using std::numbers::pi;

// Largest jumps of r, r', r'' in theta over all joints, relative to the largest size each reaches there. The end
// derivatives of the synchronisation in closed form, not from the code.
Eigen::Vector3d jumps_in_theta(const RangeSpace& space, const Eigen::VectorXd& free,
                               const BaseArcs& arcs = BaseArcs::full_circle()) {
  const double w = std::cos(arcs.arc_rad() / 2), first = 1 / (2 * std::sqrt(1 - w * w)), second = 1 / (2 * (1 + w));
  Eigen::Vector3d jump = Eigen::Vector3d::Zero(), size = Eigen::Vector3d::Constant(1e-300);
  for (int j = arcs.closed() ? 0 : 1; j < arcs.count(); ++j) {
    const int right = test::interval_of(space, j);
    const int left = j == 0 ? space.intervals() - 1 : right - 1;
    const Eigen::Vector3d F = test::from_tables(space, free, left, j == 0 ? arcs.count() : j);
    const Eigen::Vector3d G = test::from_tables(space, free, right, j);
    const Eigen::Vector3d before(F[0], F[1] * first, F[2] * first * first + F[1] * second);
    const Eigen::Vector3d after(G[0], G[1] * first, G[2] * first * first - G[1] * second);
    jump = jump.cwiseMax((after - before).cwiseAbs());
    // Each free function's own size, not only the sum's: cancellation counts as rounding of the terms.
    for (Eigen::Index k = 0; k < free.size(); ++k) {
      const Eigen::Vector3d H = test::from_tables(space, free[k] * Eigen::VectorXd::Unit(free.size(), k), right, j);
      size = size.cwiseMax(H.cwiseAbs());
    }
  }
  return jump.cwiseQuotient(size);
}

Eigen::VectorXd random_vector(std::mt19937_64& random, int n) {
  return Eigen::VectorXd::NullaryExpr(n, [&] { return test::uniform(random, -1, 1); });
}

// Every break set the joint condition has to deal with: one, two, many intervals an arc, uneven.
std::vector<std::vector<double>> layouts() {
  return {{0, 1, 2, 3, 4},
          {0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4},
          {0, 1, 1.3, 2, 2.2, 2.9, 3, 4},
          {0, 0.5, 1, 1.3, 1.6, 2, 2.5, 3, 3.2, 3.4, 4},
          {0, 0.25, 0.5, 0.75, 1, 1.25, 1.5, 1.75, 2, 2.25, 2.5, 2.75, 3, 3.25, 3.5, 3.75, 4}};
}

void expect_sound(const RangeSpace& space) {
  const Eigen::MatrixXd E = space.extraction();
  EXPECT_EQ(E.rows(), static_cast<Eigen::Index>(space.knots().size()) - space.degree() - 1);
  EXPECT_GE(E.minCoeff(), 0);
  EXPECT_LE((E.rowwise().sum().array() - 1).abs().maxCoeff(), 4e-16);
  Eigen::JacobiSVD<Eigen::MatrixXd> svd(E);
  EXPECT_GT(svd.singularValues().minCoeff(), 0.05);  // full rank, well conditioned
}

TEST(RangeSpace, ExtractionIsSoundForAllDegreesAndLayouts) {
  const BaseArcs circle = BaseArcs::full_circle();
  for (int q = 1; q <= 5; ++q) {
    for (const auto& breaks : layouts()) {
      const int n = static_cast<int>(breaks.size()) - 1;
      const RangeSpace curved = RangeSpace::over(q, circle, breaks, JointContinuity::curvature);
      expect_sound(curved);
      EXPECT_EQ(curved.free_count(), q < 3 ? n : n + 4 * (q - 3));
      const RangeSpace thesis = RangeSpace::over(q, circle, breaks, JointContinuity::thesis);
      EXPECT_EQ(thesis.free_count(), n);
      if (n > q) expect_sound(thesis);
      for (const RangeSpace& space : {curved, thesis}) {
        const Eigen::MatrixXd E = space.extraction();
        EXPECT_EQ(E.row(0), E.row(E.rows() - 1)) << "the seam, F(0) = F(4), to the bit";
        EXPECT_TRUE(space.periodic());
      }
    }
  }
}

TEST(RangeSpace, GoldenFitsByNullSpaces) {
  std::ifstream file(CELADON_SOURCE_DIR "/tests/fitting/golden/range_space.txt");
  ASSERT_TRUE(file.is_open());
  const BaseArcs circle = BaseArcs::full_circle();
  Eigen::VectorXd v(720), r(720);
  for (int i = 0; i < 720; ++i) {
    const double theta = (i + 0.5) / 720 * 2 * pi;
    v[i] = circle.v_of_theta(theta);
    r[i] = test::wavy_radius(theta);
  }
  int degree = 0, curvature = 0, cases = 0;
  std::size_t count = 0;
  while (file >> degree >> curvature >> count) {
    std::vector<double> breaks(count);
    for (double& t : breaks) file >> t;
    int dimension = 0, values = 0;
    file >> dimension >> values;
    const RangeSpace space =
        RangeSpace::over(degree, circle, breaks, curvature ? JointContinuity::curvature : JointContinuity::thesis);
    EXPECT_EQ(space.free_count(), dimension) << "degree " << degree << " curvature " << curvature;
    const Eigen::VectorXd free = test::collocation(space, v).colPivHouseholderQr().solve(r);
    for (int i = 0; i < values; ++i) {
      double theta = 0, truth = 0;
      file >> theta >> truth;
      const double at = circle.v_of_theta(theta);
      EXPECT_NEAR(test::from_tables(space, free, test::interval_of(space, at), at)[0], truth, 1e-9)
          << "degree " << degree << " curvature " << curvature << " breaks " << count;
    }
    ++cases;
  }
  EXPECT_EQ(cases, 32);
}

TEST(RangeSpace, RadiusIsC2InThetaAtEveryJoint) {
  const BaseArcs circle = BaseArcs::full_circle();
  std::mt19937_64 random(3);
  for (int q = 3; q <= 5; ++q) {
    for (const auto& breaks : layouts()) {
      const RangeSpace space = RangeSpace::over(q, circle, breaks, JointContinuity::curvature);
      const Eigen::Vector3d jump = jumps_in_theta(space, random_vector(random, space.free_count()));
      EXPECT_LE(jump.maxCoeff(), 1e-12) << "degree " << q << ": " << jump.transpose();
    }
  }
}

TEST(RangeSpace, ThesisSpaceIsOnlyC1InThetaAtTheJoints) {
  const BaseArcs circle = BaseArcs::full_circle();
  std::mt19937_64 random(4);
  for (int q = 3; q <= 5; ++q) {
    const RangeSpace space = RangeSpace::over(q, circle, 4, JointContinuity::thesis);
    const Eigen::VectorXd free = random_vector(random, space.free_count());
    const Eigen::Vector3d jump = jumps_in_theta(space, free);
    EXPECT_LE(jump.head<2>().maxCoeff(), 1e-12);
    EXPECT_GT(jump[2], 1e-3) << "the curvature break this project goes past";
    // In v it is C(q-1), joints included.
    for (int j = 0; j < 4; ++j) {
      const int right = j * 4, left = (right + 15) % 16;
      const Eigen::Vector3d a = test::from_tables(space, free, left, j == 0 ? 4 : j);
      const Eigen::Vector3d b = test::from_tables(space, free, right, j);
      EXPECT_LE((a - b).cwiseQuotient(Eigen::Vector3d(1, 4, 16)).cwiseAbs().maxCoeff(), 1e-13);
    }
  }
}

RC_GTEST_PROP(RangeSpace, RandomKnotsAreC2AndSound, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int q = std::uniform_int_distribution<int>(3, 5)(random);
  const RangeSpace space =
      RangeSpace::over(q, BaseArcs::full_circle(), test::random_closed_breaks(random), JointContinuity::curvature);
  const Eigen::MatrixXd E = space.extraction();
  RC_ASSERT(E.minCoeff() >= 0);
  RC_ASSERT((E.rowwise().sum().array() - 1).abs().maxCoeff() <= 1e-15);
  RC_ASSERT(E.fullPivLu().rank() == E.cols());
  RC_ASSERT(jumps_in_theta(space, random_vector(random, space.free_count())).maxCoeff() <= 1e-12);
}

// Tables against knots, E and basis functions: two routes to the same function; active functions in cyclic order.
RC_GTEST_PROP(RangeSpace, TablesAgreeWithTheBSplineForm, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int q = std::uniform_int_distribution<int>(1, 5)(random);
  const int kind = std::uniform_int_distribution<int>(0, 2)(random);
  const auto breaks = test::random_closed_breaks(random);
  const RangeSpace space = kind == 0
                               ? RangeSpace::open(q, breaks)
                               : RangeSpace::over(q, BaseArcs::full_circle(), breaks,
                                                  kind == 1 ? JointContinuity::curvature : JointContinuity::thesis);
  RC_ASSERT(space.breaks() == breaks);
  RC_ASSERT(space.knots().size() == static_cast<std::size_t>(space.extraction().rows() + q + 1));
  const Eigen::VectorXd free = random_vector(random, space.free_count());
  const Eigen::VectorXd c = space.extraction() * free;
  for (int interval = 0; interval < space.intervals(); ++interval) {
    const auto active = space.active(interval);
    RC_ASSERT(static_cast<int>(active.size()) == std::min(q + 1, space.free_count()));
    for (std::size_t a = 1; a < active.size(); ++a) {
      RC_ASSERT(active[a] == (active[a - 1] + 1) % space.free_count());
    }
    const auto k = static_cast<std::size_t>(interval);
    const double t = test::uniform(random, breaks[k], breaks[k + 1]);
    const int span = find_span(space.knots(), q, t);
    const auto N = basis_values(space.knots(), q, span, t);
    double sum = 0;
    for (int a = 0; a <= q; ++a) sum += N[static_cast<std::size_t>(a)] * c[span - q + a];
    RC_ASSERT(std::abs(sum - test::from_tables(space, free, interval, t)[0]) < 1e-13);
  }
}

// Breaks of an open range as a property test's seed gives them: some of the closed ones'.
std::vector<double> first_arcs(std::vector<double> breaks, int arcs) {
  std::erase_if(breaks, [&](double t) { return t > arcs; });
  return breaks;
}

RC_GTEST_PROP(RangeSpace, OpenRangesAreC2AtTheirJointsAndFreeAtTheirEnds, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int q = std::uniform_int_distribution<int>(3, 5)(random);
  const BaseArcs arcs = BaseArcs::open(test::uniform(random, -4, 4), test::uniform(random, 0.01, 2 * pi));
  const auto breaks = first_arcs(test::random_closed_breaks(random), arcs.count());
  const RangeSpace space = RangeSpace::over(q, arcs, breaks, JointContinuity::curvature);
  RC_ASSERT(!space.periodic());
  // Simple knots and C2 or more everywhere in theta: one unknown an interval, and q more; degrees over 3 have more
  // freedom at a joint (multiplicity q - 1 less one condition).
  RC_ASSERT(space.free_count() == space.intervals() + q + (arcs.count() - 1) * (q - 3));
  const Eigen::MatrixXd E = space.extraction();
  RC_ASSERT(E.minCoeff() >= 0);
  RC_ASSERT((E.rowwise().sum().array() - 1).abs().maxCoeff() <= 1e-15);
  RC_ASSERT(E.fullPivLu().rank() == E.cols());
  RC_ASSERT(E(0, 0) == 1 && E(E.rows() - 1, E.cols() - 1) == 1);
  if (arcs.count() > 1) {
    RC_ASSERT(jumps_in_theta(space, random_vector(random, space.free_count()), arcs).maxCoeff() <= 1e-12);
  }
}

// What is smooth in theta is followed across the joints of an open range as in between: fourth order for cubics.
TEST(RangeSpace, OpenRangesFollowASmoothFunctionInFourthOrder) {
  const BaseArcs arcs = BaseArcs::open(0.4, 5.1);
  const auto error = [&](int intervals_per_arc) {
    const RangeSpace space = RangeSpace::over(3, arcs, intervals_per_arc, JointContinuity::curvature);
    const int n = 4000;
    Eigen::VectorXd v(n), r(n);
    for (int i = 0; i < n; ++i) {
      const double theta = 0.4 + 5.1 * (i + 0.5) / n;
      v[i] = arcs.v_of_theta(theta), r[i] = test::wavy_radius(theta);
    }
    const Eigen::MatrixXd A = test::collocation(space, v);
    return (A * A.householderQr().solve(r) - r).cwiseAbs().maxCoeff();
  };
  const double coarse = error(16), fine = error(32);
  EXPECT_LT(fine, 2e-5);
  EXPECT_GT(coarse / fine, 12);
}

TEST(RangeSpace, EveryFunctionIsSomewhereAndConstantsAreIn) {
  for (int q = 1; q <= 5; ++q) {
    for (const auto continuity : {JointContinuity::curvature, JointContinuity::thesis}) {
      const RangeSpace space = RangeSpace::over(q, BaseArcs::full_circle(), 3, continuity);
      std::set<int> seen;
      const Eigen::VectorXd ones = Eigen::VectorXd::Ones(space.free_count());
      for (int i = 0; i < space.intervals(); ++i) {
        seen.insert(space.active(i).begin(), space.active(i).end());
        const double t = space.breaks()[static_cast<std::size_t>(i)] + 0.1;
        EXPECT_NEAR(test::from_tables(space, ones, i, t)[0], 1, 1e-14);
      }
      EXPECT_EQ(static_cast<int>(seen.size()), space.free_count());
    }
  }
}

TEST(RangeSpace, OrderFollowsTheParameter) {
  // Centres of mass of the functions, taken on the circle, advance with the index.
  for (int q = 1; q <= 5; ++q) {
    for (const auto continuity : {JointContinuity::curvature, JointContinuity::thesis}) {
      const RangeSpace space = RangeSpace::over(q, BaseArcs::full_circle(), 6, continuity);
      const int n = space.free_count();
      std::vector<double> centre;
      for (int k = 0; k < n; ++k) {
        double c = 0, s = 0;
        for (int i = 0; i < 960; ++i) {
          const double t = (i + 0.5) / 240;
          const double f = test::from_tables(space, Eigen::VectorXd::Unit(n, k), test::interval_of(space, t), t)[0];
          c += f * std::cos(t * pi / 2), s += f * std::sin(t * pi / 2);
        }
        centre.push_back(std::atan2(s, c));
      }
      for (int k = 0; k < n; ++k) {
        const double step = centre[static_cast<std::size_t>((k + 1) % n)] - centre[static_cast<std::size_t>(k)];
        EXPECT_GT(std::remainder(step, 2 * pi), 0) << "degree " << q << " function " << k;
      }
      EXPECT_LT(std::abs(centre[0]), 0.5) << "the first function is at the seam";
    }
  }
}

TEST(RangeSpace, ConstantAndOpen) {
  const RangeSpace constant = RangeSpace::constant({0, 0.5, 2});
  EXPECT_EQ(constant.degree(), 0);
  EXPECT_EQ(constant.free_count(), 1);
  EXPECT_EQ(constant.intervals(), 2);
  EXPECT_EQ(constant.knots(), (std::vector<double>{0, 2}));
  EXPECT_EQ(constant.active(1).size(), 1u);
  EXPECT_EQ(constant.polynomial(1, 0)[0], 1);
  const RangeSpace open = RangeSpace::open(3, {0, 0.5, 2});
  EXPECT_EQ(open.free_count(), 5);
  EXPECT_EQ(open.knots(), (std::vector<double>{0, 0, 0, 0, 0.5, 2, 2, 2, 2}));
  EXPECT_FALSE(open.periodic());
  EXPECT_THROW(RangeSpace::open(6, {0, 1}), std::invalid_argument);
  EXPECT_THROW(RangeSpace::open(3, {0, 0}), std::invalid_argument);
  EXPECT_THROW(RangeSpace::open(3, {0}), std::invalid_argument);
  EXPECT_THROW(RangeSpace::constant({1, 0}), std::invalid_argument);
  EXPECT_THROW(RangeSpace::over(3, BaseArcs::full_circle(), 0), std::invalid_argument);
  EXPECT_THROW(RangeSpace::over(3, BaseArcs::full_circle(), {0, 1, 2, 4}, JointContinuity::curvature),
               std::invalid_argument);
}

// Largest error of the least squares fit of the test function at 8000 angles.
double fit_error(int q, int intervals_per_arc, JointContinuity continuity) {
  const BaseArcs circle = BaseArcs::full_circle();
  const RangeSpace space = RangeSpace::over(q, circle, intervals_per_arc, continuity);
  const int n = 8000;
  Eigen::VectorXd v(n), r(n);
  for (int i = 0; i < n; ++i) {
    const double theta = (i + 0.5) / n * 2 * pi;
    v[i] = circle.v_of_theta(theta);
    r[i] = test::wavy_radius(theta);
  }
  const Eigen::MatrixXd A = test::collocation(space, v);
  const Eigen::VectorXd free = (A.transpose() * A).llt().solve(A.transpose() * r);
  return (A * free - r).cwiseAbs().maxCoeff();
}

TEST(RangeSpace, ErrorsFallAsFourthPowerAgainstSquare) {
  // The table of README.md: 64 and 128 coefficients around.
  EXPECT_NEAR(fit_error(3, 16, JointContinuity::thesis), 8.5e-4, 0.05e-4);
  EXPECT_NEAR(fit_error(3, 32, JointContinuity::thesis), 1.9e-4, 0.05e-4);
  EXPECT_NEAR(fit_error(3, 16, JointContinuity::curvature), 1.84e-4, 0.02e-4);
  EXPECT_NEAR(fit_error(3, 32, JointContinuity::curvature), 1.1e-5, 0.05e-5);
  for (int q = 4; q <= 5; ++q) {  // more degree does not help the thesis's space
    EXPECT_GT(fit_error(q, 16, JointContinuity::thesis), 1e-4);
    EXPECT_LT(fit_error(q, 16, JointContinuity::curvature), 2e-5);
  }
  EXPECT_LT(fit_error(5, 32, JointContinuity::curvature), 4e-8);  // 136 coefficients
}

TEST(RangeSpace, GramMatrixIsAsWellConditionedAsAUniformSpline) {
  const BaseArcs circle = BaseArcs::full_circle();
  for (const int m : {1, 2, 4, 8, 16}) {
    const RangeSpace space = RangeSpace::over(3, circle, m);
    const int n = 160 * m;
    Eigen::VectorXd v(n);
    for (int i = 0; i < n; ++i) v[i] = circle.v_of_theta((i + 0.5) / n * 2 * pi);
    const Eigen::MatrixXd A = test::collocation(space, v);
    const Eigen::VectorXd e = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(A.transpose() * A).eigenvalues();
    const double condition = e[e.size() - 1] / e[0];
    EXPECT_LT(condition, 21) << m;
    if (m > 1) {
      EXPECT_GT(condition, 12) << m;
    }
  }
}

}  // namespace
}  // namespace celadon
