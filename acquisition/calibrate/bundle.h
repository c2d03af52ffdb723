#pragma once
// The joint least squares of a calibration, and its normal equations.

#include <Eigen/Core>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibrate/observations.h"
#include "acquisition/calibrate/shared_errors.h"

namespace celadon::calibrate {

/// Weighted least squares from an estimate near the solution; the weights stay as they are.
/// Errors: nothing left to solve, or no finite solution.
tl::expected<Estimate, std::string> solve_bundle(const Observations& observations, const Estimate& start);

/// First columns of the blocks that all views share; -1 for those that an estimate does not have.
struct SharedLayout {
  explicit SharedLayout(const Estimate& estimate);
  int camera = 0, print = 9, axis = -1, turn = -1, platter = -1, elevation = -1, lift = -1;
  std::vector<int> planes;
  int size = 0;
};

/// What the normal equations say about the shared parameters, the poses eliminated.
struct SharedInformation {
  Eigen::MatrixXd covariance;  ///< in the charts of the estimate, in the order of SharedLayout
  bool determined = true;      ///< false: a direction of the parameters is seen by nothing
  double chi_square = 0;
  int degrees_of_freedom = 0;
  std::vector<Grouping> groupings;  ///< Origin::kGroupings
};
SharedInformation shared_information(const Observations& observations, const Estimate& estimate);

}  // namespace celadon::calibrate
