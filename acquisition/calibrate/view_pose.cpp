#include "acquisition/calibrate/view_pose.h"

#include <ceres/jet.h>
#include <ceres/rotation.h>

#include <cmath>

namespace celadon::calibrate {
namespace {

/// A chart's direction, moved along u[0], u[1].
template <typename Jet>
Eigen::Matrix<Jet, 3, 1> moved_along(const Eigen::Vector3d& direction, const Tangents& across, const Jet* u) {
  const Eigen::Matrix<Jet, 3, 1> out =
      direction.cast<Jet>() + across.cast<Jet>() * Eigen::Matrix<Jet, 2, 1>(u[0], u[1]);
  return out / sqrt(out.squaredNorm());
}

/// A chart's point, moved along u[2], u[3].
template <typename Jet>
Eigen::Matrix<Jet, 3, 1> moved_point(const Eigen::Vector3d& point, const Tangents& across, const Jet* u) {
  return point.cast<Jet>() + across.cast<Jet>() * Eigen::Matrix<Jet, 2, 1>(u[2], u[3]);
}

}  // namespace

ViewPose::ViewPose(const Estimate& estimate, const ViewObservation& view)
    : X_CB_(estimate.X_CB[static_cast<std::size_t>(view.pose)]), turned_(view.turned() && estimate.axis) {
  if (!turned_) return;
  axis_ = *estimate.axis;
  const double from = view.reference_rad, to = view.encoder_rad;
  turn_by_ = {to - from, std::cos(to) - std::cos(from), std::sin(to) - std::sin(from)};
  stop_ = view.stop;
  if (stop_.elevation_rad != 0) elevation_ = estimate.elevation;
  if (stop_.lift_mm != 0) lift_ = estimate.lift;
}

std::vector<int> ViewPose::block_sizes() const {
  std::vector<int> out = {kOwn};
  if (turned_) out.insert(out.end(), {kAxis, kTurn});
  if (elevation_) out.push_back(kElevation);
  if (lift_) out.push_back(kLift);
  return out;
}

std::vector<double*> ViewPose::blocks_of(Parameters& parameters, int pose) const {
  std::vector<double*> out = {parameters.poses[static_cast<std::size_t>(pose)].data()};
  if (turned_) out.insert(out.end(), {parameters.axis.data(), parameters.turn.data()});
  if (elevation_) out.push_back(parameters.elevation.data());
  if (lift_) out.push_back(parameters.lift.data());
  return out;
}

ViewPose::Value ViewPose::at(double const* const* blocks) const {
  if (elevation_ || lift_) return value<kAll>(blocks);
  return turned_ ? value<kTurned>(blocks) : value<kOwn>(blocks);
}

template <int kNumbers>
ViewPose::Value ViewPose::value(double const* const* blocks) const {
  using Jet = ceres::Jet<double, kNumbers>;
  using Vector = Eigen::Matrix<Jet, 3, 1>;
  using Matrix = Eigen::Matrix<Jet, 3, 3>;
  Jet x[kNumbers];
  const auto read = [&](double const* block, int first, int size) {
    for (int i = 0; i < size; ++i) x[first + i] = Jet(block[i], first + i);
  };
  read(blocks[0], 0, kOwn);
  Matrix turn;
  ceres::AngleAxisToRotationMatrix(x, turn.data());
  Matrix R = turn * X_CB_.linear().cast<Jet>();
  Vector t = X_CB_.translation().cast<Jet>() + Vector(x[3], x[4], x[5]);
  [[maybe_unused]] const auto turn_about = [&](const Vector& direction, const Vector& point, const Jet& angle) {
    const Vector about = direction * angle;
    ceres::AngleAxisToRotationMatrix(about.data(), turn.data());
    R = (turn * R).eval();
    t = (turn * (t - point) + point).eval();
  };
  if constexpr (kNumbers >= kTurned) {
    read(blocks[1], kOwn, kAxis);
    read(blocks[2], kOwn + kAxis, kTurn);
    const Jet* const u = x + kOwn;
    turn_about(moved_along(axis_.direction_C, axis_.across_C, u), moved_point(axis_.point_C, axis_.across_C, u),
               u[kAxis] * turn_by_[0] + u[kAxis + 1] * turn_by_[1] + u[kAxis + 2] * turn_by_[2]);
  }
  if constexpr (kNumbers == kAll) {
    int block = 3;
    if (elevation_) read(blocks[block++], kTurned, kElevation);
    if (lift_) {
      read(blocks[block], kTurned + kElevation, kLift);
      const Jet* const u = x + kTurned + kElevation;
      t += moved_along(lift_->direction_C, lift_->across_C, u) * (u[2] * stop_.lift_mm);
    }
    if (elevation_) {
      const Jet* const u = x + kTurned;
      turn_about(moved_along(elevation_->direction_C, elevation_->across_C, u),
                 moved_point(elevation_->point_C, elevation_->across_C, u), u[4] * -stop_.elevation_rad);
    }
  }
  Value out;
  out.R_by.resize(9, kNumbers);
  out.t_by.resize(3, kNumbers);
  for (int i = 0; i < 9; ++i) {
    out.R.data()[i] = R.data()[i].a;
    out.R_by.row(i) = R.data()[i].v.transpose();
  }
  for (int i = 0; i < 3; ++i) {
    out.t[i] = t[i].a;
    out.t_by.row(i) = t[i].v.transpose();
  }
  return out;
}

void ViewPose::spread(const Rows& by, double** jacobians) const {
  int block = 0;
  const auto write = [&](int first, int size) {
    if (jacobians[block] != nullptr) Eigen::Map<Rows>(jacobians[block], by.rows(), size) = by.middleCols(first, size);
    ++block;
  };
  write(0, kOwn);
  if (turned_) {
    write(kOwn, kAxis);
    write(kOwn + kAxis, kTurn);
  }
  if (elevation_) write(kTurned, kElevation);
  if (lift_) write(kTurned + kElevation, kLift);
}

}  // namespace celadon::calibrate
