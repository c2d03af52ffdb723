#include "acquisition/calibrate/initial_planes.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <optional>
#include <random>
#include <set>

#include "acquisition/calibrate/line_distance.h"

namespace celadon::calibrate {
namespace {

using Eigen::Vector3d;

struct PointOnBoard {
  Vector3d p_C;
  int view;
};

std::vector<PointOnBoard> points_of(const Estimate& estimate, const Observations& observations, int laser) {
  std::vector<PointOnBoard> out;
  for (const ViewObservation& view : observations.views) {
    if (!view.used) continue;
    const Eigen::Isometry3d X_CB = pose_of(estimate, view);
    const Vector3d m = X_CB.linear().col(2);
    for (const LineObservation& line : view.lines) {
      if (line.laser != laser) continue;
      for (const PointObservation& point : line.points) {
        const PlanePoint at = plane_point(ray_of(estimate.camera.data(), point.p_px), m, m.dot(X_CB.translation()));
        if (at.exists) out.push_back({at.p_C, view.view});
      }
    }
  }
  return out;
}

double median_distance(const std::vector<PointOnBoard>& points, const Vector3d& normal, double distance) {
  // A few hundred points say as much as all.
  const std::size_t stride = std::max<std::size_t>(points.size() / 500, 1);
  std::vector<double> sizes;
  for (std::size_t i = 0; i < points.size(); i += stride)
    sizes.push_back(std::abs(normal.dot(points[i].p_C) - distance));
  const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::nth_element(sizes.begin(), middle, sizes.end());
  return *middle;
}

/// The plane that the middle point is nearest to, among those through three random points of two views and more; then
/// least squares with reweighting.
std::optional<PlaneEstimate> plane_through(const std::vector<PointOnBoard>& points) {
  constexpr int kTrials = 300, kRefinements = 20;
  std::set<int> views;
  for (const PointOnBoard& point : points) views.insert(point.view);
  if (views.size() < 2) return std::nullopt;
  std::mt19937_64 random(1);  // a distribution of the standard library differs between libraries
  const auto any = [&] { return points[random() % points.size()]; };
  PlaneEstimate best;
  double smallest = std::numeric_limits<double>::infinity();
  for (int trial = 0; trial < kTrials; ++trial) {
    const PointOnBoard a = any(), b = any(), c = any();
    const Vector3d normal = (b.p_C - a.p_C).cross(c.p_C - a.p_C);
    if ((a.view == b.view && b.view == c.view) || normal.norm() < 1) continue;  // mm^2
    const Vector3d n = normal.normalized();
    const double size = median_distance(points, n, n.dot(a.p_C));
    if (size < smallest) {
      smallest = size;
      best.normal_C = n;
      best.distance_mm = n.dot(a.p_C);
    }
  }
  if (!std::isfinite(smallest)) return std::nullopt;
  for (int k = 0; k < kRefinements; ++k) {
    const double unit = std::max(1e-6, 3 * median_distance(points, best.normal_C, best.distance_mm));
    double sum = 0;
    Vector3d middle = Vector3d::Zero();
    Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
    for (const PointOnBoard& point : points) {
      const double share = (best.normal_C.dot(point.p_C) - best.distance_mm) / unit;
      const double root = 1 / (1 + share * share), weight = root * root;
      sum += weight;
      middle += weight * point.p_C;
      squares += weight * point.p_C * point.p_C.transpose();
    }
    middle /= sum;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(squares / sum - middle * middle.transpose());
    // Lines that lie on one line of space leave the plane free to turn about it.
    constexpr double kNarrowest = 0.25;  // mm^2
    if (solver.eigenvalues()[1] < kNarrowest) return std::nullopt;
    best.normal_C = solver.eigenvectors().col(0);
    best.distance_mm = best.normal_C.dot(middle);
  }
  if (best.distance_mm < 0) {
    best.normal_C = -best.normal_C;
    best.distance_mm = -best.distance_mm;
  }
  best.anchor_C = best.normal_C * best.distance_mm;
  best.tangents_C = tangents_across(best.normal_C);
  return best;
}

}  // namespace

void initial_planes(Estimate& estimate, Observations& observations) {
  std::set<int> lasers;
  for (const ViewObservation& view : observations.views) {
    for (const LineObservation& line : view.lines) lasers.insert(line.laser);
  }
  estimate.planes.clear();
  for (int laser : lasers) {
    auto plane = plane_through(points_of(estimate, observations, laser));
    if (!plane) continue;
    plane->laser = laser;
    const int index = static_cast<int>(estimate.planes.size());
    estimate.planes.push_back(*plane);
    const auto assign = [&](std::vector<LineObservation>& lines) {
      for (LineObservation& line : lines) {
        if (line.laser == laser) line.plane = index;
      }
    };
    for (ViewObservation& view : observations.views) assign(view.lines);
    assign(observations.platter);
  }
}

void initial_platter(Estimate& estimate, const Observations& observations) {
  if (!estimate.axis) return;
  AxisEstimate& axis = *estimate.axis;
  const auto middle_height = [&](std::vector<double> heights) {
    const auto middle = heights.begin() + static_cast<std::ptrdiff_t>(heights.size() / 2);
    std::nth_element(heights.begin(), middle, heights.end());
    return *middle;
  };
  std::vector<double> heights, boards;
  for (const LineObservation& line : observations.platter) {
    if (line.plane < 0) continue;
    const PlaneEstimate& plane = estimate.planes[static_cast<std::size_t>(line.plane)];
    for (const PointObservation& point : line.points) {
      const PlanePoint at = plane_point(ray_of(estimate.camera.data(), point.p_px), plane.normal_C, plane.distance_mm);
      if (at.exists) heights.push_back(axis.direction_C.dot(at.p_C - axis.point_C));
    }
  }
  if (heights.empty()) return;
  for (const ViewObservation& view : observations.views) {
    if (!view.used || !view.turned()) continue;
    boards.push_back(axis.direction_C.dot(pose_at_zero(estimate, view).translation() - axis.point_C));
  }
  double height = middle_height(heights);
  if (!boards.empty() && middle_height(boards) < height) {
    axis.direction_C = -axis.direction_C;
    axis.turn = -axis.turn;
    axis.across_C = tangents_across(axis.direction_C);
    height = -height;
  }
  estimate.platter = PlatterEstimate{height, Eigen::Vector2d::Zero()};
}

}  // namespace celadon::calibrate
