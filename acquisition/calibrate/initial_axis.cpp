#include "acquisition/calibrate/initial_axis.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>

namespace celadon::calibrate {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// Motion between two views of a placement.
struct Motion {
  double encoder_rad;
  Matrix3d R;
  Vector3d rotation;  ///< its vector
  const Eigen::Isometry3d *from, *to;
};

Motion motion_between(const Estimate& estimate, const ViewObservation& from, const ViewObservation& to) {
  Motion out;
  out.from = &estimate.X_CB[static_cast<std::size_t>(from.pose)];
  out.to = &estimate.X_CB[static_cast<std::size_t>(to.pose)];
  out.encoder_rad = to.encoder_rad - from.encoder_rad;
  out.R = out.to->linear() * out.from->linear().transpose();
  const Eigen::AngleAxisd turned(out.R);
  out.rotation = turned.angle() * turned.axis();
  return out;
}

double middle_of(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Used views of each placement in the encoder's order, of those with head and lift at 0.
std::map<int, std::vector<const ViewObservation*>> placements_of(const Observations& observations) {
  std::map<int, std::vector<const ViewObservation*>> out;
  for (const ViewObservation& view : observations.views) {
    if (view.used && view.turned() && view.at_zero()) out[view.placement].push_back(&view);
  }
  for (auto& [placement, views] : out) {
    std::stable_sort(views.begin(), views.end(),
                     [](const auto* a, const auto* b) { return a->encoder_rad < b->encoder_rad; });
  }
  return out;
}

constexpr int kReweightings = 20;

/// Rotation vector per encoder angle: reweighted least squares from the middle of successive motions.
Vector3d rotation_per_angle(const std::vector<Motion>& motions, const Vector3d& start) {
  Vector3d per_angle = start;
  for (int k = 0; k < kReweightings; ++k) {
    std::vector<double> sizes;
    for (const Motion& m : motions) sizes.push_back((m.rotation - per_angle * m.encoder_rad).norm());
    const double unit = std::max(1e-6, 1.5 * middle_of(sizes));
    Vector3d sum = Vector3d::Zero();
    double weights = 0;
    for (std::size_t i = 0; i < motions.size(); ++i) {
      const double root = 1 / (1 + sizes[i] * sizes[i] / (unit * unit)), weight = root * root;
      sum += weight * motions[i].encoder_rad * motions[i].rotation;
      weights += weight * motions[i].encoder_rad * motions[i].encoder_rad;
    }
    per_angle = sum / weights;
  }
  return per_angle;
}

/// The point that stays: (1 - R) c = t_to - R t_from for every motion, least squares with reweighting.
Vector3d fixed_point(const std::vector<Motion>& motions, const AxisEstimate& axis) {
  const Vector3d& a = axis.direction_C;
  Vector3d point = Vector3d::Zero();
  double unit = 0;
  for (int k = 0; k < kReweightings; ++k) {
    Matrix3d N = Matrix3d::Zero();
    Vector3d g = Vector3d::Zero(), middle = Vector3d::Zero();
    std::vector<double> sizes;
    for (const Motion& m : motions) {
      const Matrix3d R = Eigen::AngleAxisd(axis.turn * m.encoder_rad, a).toRotationMatrix();
      const Matrix3d A = Matrix3d::Identity() - R;
      const Vector3d b = m.to->translation() - R * m.from->translation(), e = A * point - b;
      const Vector3d across = e - a * a.dot(e);
      const double root = unit > 0 ? 1 / (1 + across.squaredNorm() / (unit * unit)) : 1, weight = root * root;
      sizes.push_back(across.norm());
      N += weight * A.transpose() * A;
      g += weight * A.transpose() * b;
      middle += m.from->translation() / static_cast<double>(motions.size());
    }
    // Along the axis every point stays; the one beside the boards is taken.
    N += N.trace() * a * a.transpose();
    g += N.trace() * 0.5 * a * a.dot(middle);
    if (k > 0) unit = std::max(1e-6, 1.5 * middle_of(sizes));
    point = N.ldlt().solve(g);
    point += a * a.dot(middle - point);
  }
  return point;
}

}  // namespace

std::optional<AxisEstimate> initial_axis(const Estimate& estimate, const Observations& observations) {
  constexpr double kSmallestAngle = 0.017, kLargestRotation = 2.5;
  const auto placements = placements_of(observations);
  std::vector<double> x, y, z;
  for (const auto& [placement, views] : placements) {
    for (std::size_t i = 1; i < views.size(); ++i) {
      const Motion m = motion_between(estimate, *views[i - 1], *views[i]);
      if (m.encoder_rad < 1e-6) continue;
      x.push_back(m.rotation.x() / m.encoder_rad);
      y.push_back(m.rotation.y() / m.encoder_rad);
      z.push_back(m.rotation.z() / m.encoder_rad);
    }
  }
  if (x.empty()) return std::nullopt;
  const Vector3d start(middle_of(x), middle_of(y), middle_of(z));

  std::vector<Motion> motions;
  double largest = 0;
  for (const auto& [placement, views] : placements) {
    for (std::size_t i = 0; i < views.size(); ++i) {
      for (std::size_t k = i + 1; k < views.size(); ++k) {
        Motion m = motion_between(estimate, *views[i], *views[k]);
        if (m.encoder_rad < 1e-6 || start.norm() * m.encoder_rad > kLargestRotation) continue;
        largest = std::max(largest, m.encoder_rad);
        motions.push_back(std::move(m));
      }
    }
  }
  if (largest < kSmallestAngle || start.norm() * largest < kSmallestAngle) return std::nullopt;

  AxisEstimate out;
  const Vector3d per_angle = rotation_per_angle(motions, start);
  out.turn = per_angle.norm();
  if (!(out.turn * largest > 0.5 * kSmallestAngle)) return std::nullopt;
  out.direction_C = per_angle / out.turn;
  // Upward in the picture, whose y axis points down; the sense of turning follows.
  if (out.direction_C.y() > 0) {
    out.direction_C = -out.direction_C;
    out.turn = -out.turn;
  }
  out.across_C = tangents_across(out.direction_C);
  out.point_C = fixed_point(motions, out);
  return out;
}

void gather_placements(Estimate& estimate, Observations& observations) {
  const AxisEstimate axis = *estimate.axis;
  const auto turned_by = [&](double encoder_rad) {
    return Eigen::Translation3d(axis.point_C) * Eigen::AngleAxisd(axis.turn * encoder_rad, axis.direction_C) *
           Eigen::Translation3d(-axis.point_C);
  };
  std::vector<Eigen::Isometry3d> poses;
  std::map<int, int> pose_of_placement;
  std::map<int, double> reference;
  const auto placements = placements_of(observations);
  for (const auto& [placement, views] : placements) {
    reference[placement] = views[views.size() / 2]->encoder_rad;
    std::vector<Eigen::Isometry3d> candidates;
    for (const ViewObservation* view : views) {
      candidates.push_back(turned_by(reference[placement] - view->encoder_rad) *
                           estimate.X_CB[static_cast<std::size_t>(view->pose)]);
    }
    std::size_t best = 0;
    double smallest = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      std::vector<double> apart;
      for (const auto& other : candidates) {
        // Three places on a board, for its turn counts as well.
        double sum = 0;
        for (const Vector3d& p : {Vector3d(0, 0, 0), Vector3d(30, 0, 0), Vector3d(0, 30, 0)}) {
          sum += (candidates[i] * p - other * p).norm();
        }
        apart.push_back(sum);
      }
      const double size = middle_of(apart);
      if (size < smallest) {
        smallest = size;
        best = i;
      }
    }
    pose_of_placement[placement] = static_cast<int>(poses.size());
    poses.push_back(candidates[best]);
  }
  for (ViewObservation& view : observations.views) {
    if (view.turned() && pose_of_placement.count(view.placement) > 0) {
      view.reference_rad = reference[view.placement];
      view.pose = pose_of_placement[view.placement];
    } else {
      poses.push_back(estimate.X_CB[static_cast<std::size_t>(view.pose)]);
      view.pose = static_cast<int>(poses.size()) - 1;
    }
  }
  estimate.X_CB = std::move(poses);
}

}  // namespace celadon::calibrate
