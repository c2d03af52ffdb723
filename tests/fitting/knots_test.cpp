#include "fitting/knots.h"

#include <gtest/gtest.h>

#include <fstream>
#include <random>

#include "fitting/bspline_basis.h"
#include "tests/build_paths.h"
#include "tests/fitting/spline_tools.h"

namespace celadon {
namespace {

double spline(const std::vector<double>& knots, int degree, const Eigen::VectorXd& c, double t) {
  const int span = find_span(knots, degree, t);
  const auto N = basis_values(knots, degree, span, t);
  double sum = 0;
  for (int a = 0; a <= degree; ++a) sum += N[static_cast<std::size_t>(a)] * c[span - degree + a];
  return sum;
}

TEST(Knots, GoldenBasisValuesAndDerivatives) {
  std::ifstream file(CELADON_SOURCE_DIR "/tests/fitting/golden/basis.txt");
  ASSERT_TRUE(file.is_open());
  int degree = 0, cases = 0;
  std::size_t count = 0, parameters = 0;
  while (file >> degree >> count) {
    std::vector<double> knots(count);
    for (double& t : knots) file >> t;
    file >> parameters;
    for (std::size_t i = 0; i < parameters; ++i, ++cases) {
      double t = 0;
      file >> t;
      const int span = find_span(knots, degree, t);
      const auto D = basis_derivatives(knots, degree, span, t);
      for (std::size_t order = 0; order < 3; ++order) {
        const int n = static_cast<int>(count) - degree - 1;
        std::vector<double> row(static_cast<std::size_t>(n));
        double size = 1;
        for (double& value : row) file >> value, size = std::max(size, std::abs(value));
        for (int k = 0; k < n; ++k) {
          const int a = k - span + degree;
          const double got = a >= 0 && a <= degree ? D[order][static_cast<std::size_t>(a)] : 0.0;
          EXPECT_NEAR(got, row[static_cast<std::size_t>(k)], 1e-13 * size)
              << "degree " << degree << " t " << t << " order " << order << " function " << k;
        }
      }
    }
  }
  EXPECT_EQ(cases, 42);
}

TEST(Knots, BernsteinPolynomialsInClosedForm) {
  for (int q = 0; q <= kMaxDegree; ++q) {
    std::vector<double> knots(static_cast<std::size_t>(q) + 1, 0.0);
    knots.insert(knots.end(), static_cast<std::size_t>(q) + 1, 1.0);
    const double t = 0.3;
    const auto N = basis_values(knots, q, q, t);
    for (int k = 0; k <= q; ++k) {
      EXPECT_NEAR(N[static_cast<std::size_t>(k)], binomial(q, k) * std::pow(t, k) * std::pow(1 - t, q - k), 1e-15);
    }
    // Power form: the same polynomials at s = 2t - 1.
    const IntervalMatrix& T = power_from_bezier(q);
    for (int k = 0; k <= q; ++k) {
      double p = 0;
      for (int m = q; m >= 0; --m) p = p * (2 * t - 1) + T(m, k);
      EXPECT_NEAR(p, N[static_cast<std::size_t>(k)], 1e-14);
    }
  }
}

TEST(Knots, BinomialsArePascalsTriangle) {
  for (int n = 1; n <= kMaxDegree; ++n) {
    for (int k = 1; k < n; ++k) EXPECT_EQ(binomial(n, k), binomial(n - 1, k - 1) + binomial(n - 1, k));
    EXPECT_EQ(binomial(n, 0), 1);
    EXPECT_EQ(binomial(n, n), 1);
  }
}

TEST(Knots, SpanIsRightSidedAndLastAtTheEnd) {
  const std::vector<double> knots{0, 0, 0, 1, 1, 2, 3, 3, 3};
  EXPECT_EQ(find_span(knots, 2, -1), 2);
  EXPECT_EQ(find_span(knots, 2, 0), 2);
  EXPECT_EQ(find_span(knots, 2, 0.999), 2);
  EXPECT_EQ(find_span(knots, 2, 1), 4);
  EXPECT_EQ(find_span(knots, 2, 2), 5);
  EXPECT_EQ(find_span(knots, 2, 3), 5);
  EXPECT_EQ(find_span(knots, 2, 9), 5);
}

TEST(Knots, GrevilleNodesReproduceLines) {
  const std::vector<double> knots{0, 0, 0, 0, 0.1, 0.1, 0.4, 0.9, 1, 1, 1, 1};
  const auto nodes = greville_abscissae(knots, 3);
  const Eigen::VectorXd c = Eigen::Map<const Eigen::VectorXd>(nodes.data(), static_cast<Eigen::Index>(nodes.size()));
  for (double t = 0; t <= 1; t += 0.05) EXPECT_NEAR(spline(knots, 3, c, t), t, 1e-15);
  EXPECT_EQ(nodes.front(), 0.0);
  EXPECT_EQ(nodes.back(), 1.0);
}

TEST(Knots, InsertionChangesNothingAndIsConvex) {
  std::mt19937_64 random(7);
  for (int degree = 1; degree <= 7; ++degree) {
    std::vector<double> inner(8);
    for (double& t : inner) t = test::uniform(random, 0, 1);
    std::sort(inner.begin(), inner.end());
    std::vector<double> breaks{0};
    breaks.insert(breaks.end(), inner.begin(), inner.end());
    breaks.push_back(1);
    const auto knots = clamped_knots(degree, breaks);
    std::vector<double> added{inner[3], 0.5, 0.123};
    for (int k = 1; k < degree; ++k) added.push_back(inner[3]);
    added.pop_back();
    const Refinement refined = insert_knots(knots, degree, added);
    const Eigen::VectorXd c = Eigen::VectorXd::NullaryExpr(static_cast<Eigen::Index>(knots.size()) - degree - 1,
                                                           [&] { return test::uniform(random, -1, 1); });
    const Eigen::VectorXd d = refined.map * c;
    ASSERT_EQ(refined.knots.size(), knots.size() + added.size());
    EXPECT_TRUE(std::is_sorted(refined.knots.begin(), refined.knots.end()));
    for (double t = 0; t < 1; t += 0.013) {
      EXPECT_NEAR(spline(knots, degree, c, t), spline(refined.knots, degree, d, t), 1e-14);
    }
    for (Eigen::Index i = 0; i < refined.map.rows(); ++i) {
      EXPECT_NEAR(refined.map.row(i).sum(), 1, 1e-15);
      for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator it(refined.map, i); it; ++it) {
        EXPECT_GE(it.value(), 0);
      }
    }
  }
}

TEST(Knots, BadVectorsAreRefused) {
  using V = std::vector<double>;
  EXPECT_THROW(require_clamped(V{0, 0, 1, 1}, 2, "x"), std::invalid_argument);                       // too few
  EXPECT_THROW(require_clamped(V{0, 0, 0, 0.5, 0.2, 1, 1, 1}, 2, "x"), std::invalid_argument);       // not ascending
  EXPECT_THROW(require_clamped(V{0, 0, 0.1, 0.5, 1, 1, 1}, 2, "x"), std::invalid_argument);          // not clamped
  EXPECT_THROW(require_clamped(V{0, 0, 0, 0.5, 0.5, 0.5, 1, 1, 1}, 2, "x"), std::invalid_argument);  // torn
  EXPECT_THROW(require_clamped(V{0, 0, 0, NAN, 1, 1, 1}, 2, "x"), std::invalid_argument);
  EXPECT_NO_THROW(require_clamped(V{0, 0, 0, 0.5, 0.5, 1, 1, 1}, 2, "x"));
  EXPECT_THROW(insert_knots(V{0, 0, 1, 1}, 1, V{1.5}), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
