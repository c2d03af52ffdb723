#include "acquisition/calibrate/shared_errors.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <random>

namespace celadon::calibrate {
namespace {

/// Linear least squares over groups of observations, sigma 1, whose members share an error.
struct Draws {
  Eigen::MatrixXd model, stated, observed;  ///< stated: mean over the draws
  int unchanged = 0, draws = 0;
};

Draws draw(double shared_sigma, int draws) {
  constexpr int kParameters = 6, kGroups = 80, kMembers = 25;
  constexpr auto kRows = static_cast<Eigen::Index>(kGroups) * kMembers;
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  const Eigen::MatrixXd J = Eigen::MatrixXd::NullaryExpr(
      kRows, kParameters, [&] { return 0.3 + normal(random); });  // 0.3: a group has a lean
  const Eigen::MatrixXd C = (J.transpose() * J).inverse();
  Draws out{C, Eigen::MatrixXd::Zero(kParameters, kParameters), Eigen::MatrixXd::Zero(kParameters, kParameters), 0,
            draws};
  for (int k = 0; k < draws; ++k) {
    Eigen::VectorXd error(kRows);
    for (int group = 0; group < kGroups; ++group) {
      const double shared = shared_sigma * normal(random);
      for (int i = 0; i < kMembers; ++i) error[group * kMembers + i] = shared + normal(random);
    }
    const Eigen::VectorXd x = C * J.transpose() * error, left = error - J * x;
    std::vector<Grouping> groupings(1);
    for (int group = 0; group < kGroups; ++group) {
      const auto rows = J.middleRows(group * kMembers, kMembers);
      groupings[0][group] = {rows.transpose() * left.segment(group * kMembers, kMembers), rows.transpose() * rows};
    }
    const Eigen::MatrixXd covariance = with_shared_errors(C, 1, groupings);
    out.unchanged += covariance == C;
    out.stated += covariance / draws;
    out.observed += x * x.transpose() / draws;
  }
  return out;
}

TEST(SharedErrors, IndependentErrorsLeaveTheModelsCovariance) {
  const Draws draws = draw(0, 200);
  EXPECT_GE(draws.unchanged, 198);
}

// The parameters' sum is where the groups lean: its error is many times what the model says.
TEST(SharedErrors, ErrorsOfGroupsAreStatedAsTheyAre) {
  const Draws draws = draw(2, 300);
  EXPECT_EQ(draws.unchanged, 0);
  const Eigen::VectorXd sum = Eigen::VectorXd::Ones(draws.model.rows());
  const double model = sum.dot(draws.model * sum), stated = sum.dot(draws.stated * sum);
  const double observed = sum.dot(draws.observed * sum);
  EXPECT_GT(observed, 20 * model);
  EXPECT_NEAR(std::sqrt(stated / observed), 1, 0.15);
}

TEST(SharedErrors, NothingIsEverStatedSurerThanByTheModel) {
  const Draws draws = draw(0.5, 50);
  const Eigen::MatrixXd more = draws.stated - draws.model;
  EXPECT_GE(more.diagonal().minCoeff(), -1e-15);
  EXPECT_TRUE(
      Eigen::LDLT<Eigen::MatrixXd>(more + 1e-12 * Eigen::MatrixXd::Identity(more.rows(), more.cols())).isPositive());
}

}  // namespace
}  // namespace celadon::calibrate
