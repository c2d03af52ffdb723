#include "acquisition/calibrate/shared_errors.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace celadon::calibrate {

Eigen::MatrixXd with_shared_errors(const Eigen::MatrixXd& covariance, double inflation,
                                   const std::vector<Grouping>& groupings) {
  // Largest eigenvalue that a scatter of G independent groups in P directions has by chance is (1 + sqrt(P / G))^2 for
  // groups of one size (Marchenko and Pastur 1967); these differ in size.
  constexpr double kUneven = 1.5;
  constexpr double kMostLeverage = 0.7;  // a group that alone tells a number predicts itself badly without it
  const Eigen::Index P = covariance.rows();
  const Eigen::VectorXd unit = covariance.diagonal().cwiseMax(0).cwiseSqrt();
  const Eigen::VectorXd inverse_unit = (unit.array() > 0).select(unit.cwiseInverse(), 0.0);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> correlation(inverse_unit.asDiagonal() * covariance *
                                                                   inverse_unit.asDiagonal());
  // covariance = root root^T
  const Eigen::MatrixXd root =
      unit.asDiagonal() * correlation.eigenvectors() * correlation.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
  Eigen::MatrixXd out = covariance;
  for (const Grouping& groups : groupings) {
    Eigen::MatrixXd scatter = Eigen::MatrixXd::Zero(P, P), expected = scatter;
    for (const auto& [number, sums] : groups) {
      // In whitened directions, each group predicted by the others (leave one out), as far as they can.
      const Eigen::MatrixXd share = root.transpose() * sums.information * root / (inflation * inflation);
      const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(share);
      const Eigen::VectorXd left = (1 - solver.eigenvalues().array().min(kMostLeverage)).inverse();
      const Eigen::VectorXd score =
          solver.eigenvectors() * (left.asDiagonal() * (solver.eigenvectors().transpose() *
                                                        (root.transpose() * sums.score / (inflation * inflation))));
      scatter += score * score.transpose();
      expected += share;
    }
    // What no group of this grouping tells is as the model says.
    scatter += Eigen::MatrixXd::Identity(P, P) - expected;
    const double by_chance =
        kUneven *
        std::pow(1 + std::sqrt(static_cast<double>(P) / static_cast<double>(std::max<std::size_t>(1, groups.size()))),
                 2);
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(scatter);
    for (Eigen::Index i = 0; i < P; ++i) {
      const double value = solver.eigenvalues()[i];
      if (value <= by_chance) continue;
      const Eigen::VectorXd direction = root * solver.eigenvectors().col(i);
      out += (value - 1) * direction * direction.transpose();
    }
  }
  return out;
}

}  // namespace celadon::calibrate
