#pragma once
// Errors that many observations share: of one view (the camera warms, a line is taken a little beside itself), of one
// corner of the print, of one part of the picture (a lens that no polynomial follows). README.md, (11).

#include <Eigen/Core>
#include <array>
#include <map>
#include <vector>

namespace celadon::calibrate {

/// Where a residual comes from. Equal numbers: the same group.
struct Origin {
  static constexpr int kGroupings = 3;
  std::array<int, kGroupings>
      group{};  ///< view, corner of the print (or place on a laser's sheet), part of the picture
};

/// Scores and information of groups of residuals, the poses eliminated.
struct GroupSums {
  Eigen::VectorXd score;        ///< J^T r
  Eigen::MatrixXd information;  ///< J^T J
};
using Grouping = std::map<int, GroupSums>;

/// The covariance that holds if the members of each group err together: the model's covariance and, for each grouping,
/// what its groups' scores scatter more than chance gives them.
/// @param covariance of the model, inflation included  @param inflation of a standard deviation
Eigen::MatrixXd with_shared_errors(const Eigen::MatrixXd& covariance, double inflation,
                                   const std::vector<Grouping>& groupings);

}  // namespace celadon::calibrate
