#include "fitting/bending_energy.h"

#include <gtest/gtest.h>

#include <random>

#include "fitting/normal_solver.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::kPi;

// The energy of free coefficients through the stencil it is added to.
double energy_of(const FitSpace& space, const Eigen::MatrixXd& free, double r_mean) {
  const BendingEnergy energy{gram_matrices(space.u), gram_matrices(space.v, BaseArcs::full_circle(), r_mean)};
  StencilMatrix m(space.u.free_count(), std::min(space.u.degree(), space.u.free_count() - 1), space.v.free_count(),
                  std::min(space.v.degree(), space.v.free_count() - 1));
  energy.add_to(m, 1);
  AlignedVector<double> x(m.field_size(), 0.0), y(m.field_size());
  for (int j = 0; j < m.count_v(); ++j)
    for (int i = 0; i < m.count_u(); ++i) x[m.at(i, j)] = free(i, j);
  m.multiply(x.data(), y.data());
  double sum = 0;
  for (std::size_t k = 0; k < x.size(); ++k) sum += x[k] * y[k];
  return sum;
}

// r = z^2 all around: r_zz = 2, so E = 4 H 2 pi r_mean.
TEST(BendingEnergy, OfAParabolaOfRevolutionIsItsClosedForm) {
  const FitSpace space{RangeSpace::open(3, test::even_breaks(0, 10, 4)),
                       RangeSpace::over(3, BaseArcs::full_circle(), 2)};
  // Coefficients of z^2: the blossom t_(i+1) t_(i+2) symmetrised over the three knots.
  Eigen::VectorXd u(space.u.free_count());
  const auto& k = space.u.knots();
  for (Eigen::Index i = 0; i < u.size(); ++i) {
    const auto a = k[static_cast<std::size_t>(i) + 1], b = k[static_cast<std::size_t>(i) + 2],
               c = k[static_cast<std::size_t>(i) + 3];
    u(i) = (a * b + b * c + a * c) / 3;
  }
  const Eigen::MatrixXd free = u * Eigen::RowVectorXd::Ones(space.v.free_count());
  EXPECT_NEAR(energy_of(space, free, 30), 4 * 10 * 2 * kPi * 30, 1e-8);
}

TEST(BendingEnergy, OfConstantsAndLinearSlopesIsZero) {
  const FitSpace space{RangeSpace::open(3, test::even_breaks(0, 10, 4)),
                       RangeSpace::over(4, BaseArcs::full_circle(), 3)};
  EXPECT_NEAR(energy_of(space, Eigen::MatrixXd::Constant(space.u.free_count(), space.v.free_count(), 30), 30), 0, 1e-9);
  Eigen::VectorXd greville(space.u.free_count());
  for (Eigen::Index i = 0; i < greville.size(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    greville(i) = (space.u.knots()[k + 1] + space.u.knots()[k + 2] + space.u.knots()[k + 3]) / 3;
  }
  EXPECT_NEAR(energy_of(space, greville * Eigen::RowVectorXd::Ones(space.v.free_count()), 30), 0, 1e-9);
}

// Against the derivatives of the range function itself, integrated by the midpoint rule in theta and z.
TEST(BendingEnergy, IsTheIntegralOfSecondDerivativesInMillimetres) {
  std::mt19937_64 random(4);
  std::uniform_real_distribution<double> share(-1, 1);
  for (const int q : {3, 4}) {
    const FitSpace space{RangeSpace::open(3, test::even_breaks(0, 40, 2)),
                         RangeSpace::over(q, BaseArcs::full_circle(), 2)};
    const Eigen::MatrixXd free =
        Eigen::MatrixXd::NullaryExpr(space.u.free_count(), space.v.free_count(), [&] { return 30 + share(random); });
    std::vector<double> knots_u = space.u.knots();
    for (double& k : knots_u) k /= 40;
    BaseSurface base;
    base.band_end = 40;
    const Eigen::MatrixXd along = space.u.extraction() * free;
    const RangeFunction f(base, 3, q, knots_u, space.v.knots(), along * space.v.extraction().transpose());
    constexpr int kAround = 1600, kAlong = 400;
    constexpr double kMean = 31;
    double sum = 0;
    for (int i = 0; i < kAround; ++i)
      for (int j = 0; j < kAlong; ++j) {
        const RangeDerivatives d = f.derivatives(2 * kPi * (i + 0.5) / kAround, 40 * (j + 0.5) / kAlong);
        const double ss = d.r_theta_theta / (kMean * kMean), sz = d.r_theta_z / kMean;
        sum += d.r_z_z * d.r_z_z + 2 * sz * sz + ss * ss;
      }
    sum *= 2 * kPi * kMean / kAround * 40 / kAlong;
    EXPECT_NEAR(energy_of(space, free, kMean), sum, 1e-4 * sum) << q;
  }
}

}  // namespace
}  // namespace celadon
