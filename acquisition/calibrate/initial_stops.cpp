#include "acquisition/calibrate/initial_stops.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <set>

namespace celadon::calibrate {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kRounds = 20;
constexpr std::size_t kFewestMotions = 2;
constexpr double kSmallestTurn_rad = 0.5 * 0.017453292519943295, kSmallestRise_mm = 0.5;

/// What a stop makes of a board, against where it would stand at 0, in the camera's frame.
struct StopMotion {
  AxisStop stop;
  Eigen::Isometry3d X;
  Vector3d middle_C;  ///< of the board at 0
};

double median_of(std::vector<double> sizes) {
  const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::nth_element(sizes.begin(), middle, sizes.end());
  return *middle;
}

/// Weights of Geman and McClure, the unit being what the middle residual shows.
std::vector<double> weights_of(const std::vector<double>& sizes) {
  const double unit = std::max(1e-6, 1.5 * median_of(sizes));
  std::vector<double> out;
  for (const double size : sizes) {
    const double root = 1 / (1 + size * size / (unit * unit));
    out.push_back(root * root);
  }
  return out;
}

/// The head's rotation vector per reading; 0: it did not turn.
Vector3d turn_per_reading(const std::vector<StopMotion>& motions) {
  std::vector<Vector3d> turns;
  std::vector<double> readings, x, y, z;
  double largest = 0;
  for (const StopMotion& m : motions) {
    const Eigen::AngleAxisd turn(m.X.linear());
    turns.push_back(-turn.angle() * turn.axis());  // the board is seen to turn the other way
    readings.push_back(m.stop.elevation_rad);
    x.push_back(turns.back().x() / readings.back());
    y.push_back(turns.back().y() / readings.back());
    z.push_back(turns.back().z() / readings.back());
    largest = std::max(largest, std::abs(readings.back()));
  }
  Vector3d per_reading(median_of(x), median_of(y), median_of(z));
  for (int round = 0; round < kRounds; ++round) {
    std::vector<double> sizes;
    for (std::size_t i = 0; i < turns.size(); ++i) sizes.push_back((turns[i] - per_reading * readings[i]).norm());
    const std::vector<double> weights = weights_of(sizes);
    Vector3d sum = Vector3d::Zero();
    double squares = 0;
    for (std::size_t i = 0; i < turns.size(); ++i) {
      sum += weights[i] * readings[i] * turns[i];
      squares += weights[i] * readings[i] * readings[i];
    }
    per_reading = sum / squares;
  }
  return per_reading.norm() * largest < kSmallestTurn_rad ? Vector3d::Zero() : per_reading;
}

/// A point of the elevation axis, and the rise per reading of the lift: (1 - R) point + reading R rise = t for each
/// motion.
struct PointAndRise {
  Vector3d point_C = Vector3d::Zero(), rise_C = Vector3d::Zero();
};
PointAndRise point_and_rise(const std::vector<StopMotion>& motions, const Vector3d& turn) {
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  using Matrix6 = Eigen::Matrix<double, 6, 6>;
  Vector3d middle = Vector3d::Zero();
  for (const StopMotion& m : motions) middle += m.middle_C / static_cast<double>(motions.size());
  const double speed = turn.norm();
  const Vector3d along = speed > 0 ? Vector3d(turn / speed) : Vector3d(Vector3d::Zero());
  Vector6 found = Vector6::Zero();
  std::vector<double> weights(motions.size(), 1);
  for (int round = 0; round < kRounds; ++round) {
    Matrix6 N = Matrix6::Zero();
    Vector6 g = Vector6::Zero();
    std::vector<Eigen::Matrix<double, 3, 6>> rows;
    for (std::size_t i = 0; i < motions.size(); ++i) {
      const StopMotion& m = motions[i];
      Matrix3d R = Matrix3d::Identity();
      if (speed > 0) R = Eigen::AngleAxisd(-speed * m.stop.elevation_rad, along).toRotationMatrix();
      rows.emplace_back();
      rows.back() << Matrix3d::Identity() - R, m.stop.lift_mm * R;
      N += weights[i] * rows.back().transpose() * rows.back();
      g += weights[i] * rows.back().transpose() * m.X.translation();
    }
    // Where nothing moved, and along the elevation axis, all is as good: the place beside the boards is taken.
    Matrix6 free = Matrix6::Zero();
    free.topLeftCorner<3, 3>() = speed > 0 ? Matrix3d(along * along.transpose()) : Matrix3d::Identity();
    const bool lifted = N.bottomRightCorner<3, 3>().trace() > 0;
    if (!lifted) free.bottomRightCorner<3, 3>().setIdentity();
    Vector6 anchor = Vector6::Zero();
    anchor.head<3>() = middle;
    N += free * N.trace();
    g += free * N.trace() * anchor;
    found = N.ldlt().solve(g);
    std::vector<double> sizes;
    for (std::size_t i = 0; i < motions.size(); ++i)
      sizes.push_back((rows[i] * found - motions[i].X.translation()).norm());
    weights = weights_of(sizes);
  }
  return {found.head<3>(), found.tail<3>()};
}

void forget(ViewObservation& view) {
  view.used = false;
  view.corners.clear();
  view.lines.clear();
}

}  // namespace

void initial_stops(const std::vector<Eigen::Isometry3d>& own_X_CB, Estimate& estimate, Observations& observations) {
  std::set<int> known;  // placements
  for (const ViewObservation& view : observations.views) {
    if (view.used && view.turned() && view.at_zero()) known.insert(view.placement);
  }
  const auto motions_of = [&](auto&& belongs) {
    std::vector<StopMotion> out;
    for (const ViewObservation& view : observations.views) {
      if (!view.used || !belongs(view)) continue;
      const Eigen::Isometry3d X_CB = pose_at_zero(estimate, view);
      out.push_back({view.stop, own_X_CB[static_cast<std::size_t>(view.view)] * X_CB.inverse(), X_CB.translation()});
    }
    return out;
  };
  for (ViewObservation& view : observations.views) {
    if (!view.at_zero() && known.count(view.placement) == 0) forget(view);
  }

  const std::vector<StopMotion> raised = motions_of([](const ViewObservation& view) { return view.raised(); });
  const Vector3d turn = raised.size() < kFewestMotions ? Vector3d(Vector3d::Zero()) : turn_per_reading(raised);
  const bool turns = turn.norm() > 0;
  for (ViewObservation& view : observations.views) {
    if (view.raised() && !turns) forget(view);
  }
  const std::vector<StopMotion> moved = motions_of([](const ViewObservation& view) { return !view.at_zero(); });
  if (moved.empty()) return;
  const PointAndRise found = point_and_rise(moved, turn);
  double highest_mm = 0;
  std::size_t lifted = 0;
  for (const StopMotion& m : moved) {
    highest_mm = std::max(highest_mm, std::abs(m.stop.lift_mm));
    lifted += std::abs(m.stop.lift_mm) > kAtZero_mm;
  }
  if (lifted >= kFewestMotions && found.rise_C.norm() * highest_mm >= kSmallestRise_mm) {
    const Vector3d direction = found.rise_C.normalized();
    estimate.lift = LiftEstimate{direction, tangents_across(direction), found.rise_C.norm()};
  }
  for (ViewObservation& view : observations.views) {
    if (view.lifted() && !estimate.lift) forget(view);
  }
  if (turns) {
    const Vector3d direction = turn.normalized();
    estimate.elevation = ElevationEstimate{direction, found.point_C, tangents_across(direction), turn.norm()};
  }
}

}  // namespace celadon::calibrate
