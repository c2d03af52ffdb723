#pragma once
// The pose of a board in one view, by everything that it depends on. README.md, (6) and (12).

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// Pose of a view with its derivatives by the numbers that it depends on: 6 of its own, for a turned view 4 of the axis
/// and 3 of its turn, and off 0 of head or lift their 5 and 3.
class ViewPose {
 public:
  static constexpr int kOwn = 6, kAxis = 4, kTurn = 3, kElevation = 5, kLift = 3;
  static constexpr int kTurned = kOwn + kAxis + kTurn, kAll = kTurned + kElevation + kLift;
  /// Derivatives of residuals, one a row.
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  /// As many columns as the view has numbers().
  struct Value {
    Eigen::Matrix3d R;
    Eigen::Vector3d t;
    Eigen::Matrix<double, 9, Eigen::Dynamic, Eigen::ColMajor, 9, kAll> R_by;  ///< column after column of R
    Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::ColMajor, 3, kAll> t_by;
  };

  ViewPose(const Estimate& estimate, const ViewObservation& view);

  int numbers() const { return elevation_ || lift_ ? kAll : turned_ ? kTurned : kOwn; }
  /// Own [, axis, turn [, elevation] [, lift]].
  std::vector<int> block_sizes() const;
  /// @param pose index of the view's own
  std::vector<double*> blocks_of(Parameters& parameters, int pose) const;

  Value at(double const* const* blocks) const;
  /// Writes d residual / d blocks, given d residual / d numbers().
  void spread(const Rows& by, double** jacobians) const;

 private:
  template <int kNumbers>
  Value value(double const* const* blocks) const;

  Eigen::Isometry3d X_CB_;
  bool turned_ = false;
  AxisEstimate axis_;
  Eigen::Vector3d turn_by_ = Eigen::Vector3d::Zero();  ///< derivative of the angle by its three numbers
  AxisStop stop_;
  std::optional<ElevationEstimate> elevation_;
  std::optional<LiftEstimate> lift_;
};

}  // namespace celadon::calibrate
