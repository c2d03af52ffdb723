#include "fitting/surface_sample.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "fitting/even_sample.h"
#include "fitting/nearest_points.h"
#include "fitting/robust_least_squares.h"

namespace celadon {
namespace {

constexpr std::size_t kDeciding = 200;

struct Plane {
  Eigen::Vector3d middle, normal;
  double deviation = 0;  // standard deviation about the plane
  double width = 0;      // standard deviation within it, the smaller one
};

Plane plane_through(const Eigen::Matrix3Xd& points, const std::vector<NearestPoints::Neighbour>& neighbours) {
  const auto N = static_cast<Eigen::Index>(neighbours.size());
  Eigen::VectorXd weights = Eigen::VectorXd::Ones(N), distances(N);
  const Eigen::VectorXd ones = weights;
  Plane plane;
  for (int round = 0; round < 3; ++round) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (Eigen::Index k = 0; k < N; ++k) sum += weights[k] * points.col(neighbours[static_cast<std::size_t>(k)].index);
    plane.middle = sum / weights.sum();
    Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
    for (Eigen::Index k = 0; k < N; ++k) {
      const Eigen::Vector3d x = points.col(neighbours[static_cast<std::size_t>(k)].index) - plane.middle;
      spread += weights[k] * x * x.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(spread / weights.sum());
    plane.normal = solver.eigenvectors().col(0);
    plane.width = std::sqrt(std::max(0.0, solver.eigenvalues()[1]));
    for (Eigen::Index k = 0; k < N; ++k)
      distances[k] = plane.normal.dot(points.col(neighbours[static_cast<std::size_t>(k)].index) - plane.middle);
    const double scale = median_scale(distances, ones);
    const auto n = static_cast<double>(N);
    plane.deviation = scale * std::sqrt(n / (n - 3));
    if (!(scale > 0)) break;
    for (Eigen::Index k = 0; k < N; ++k) weights[k] = tukey_weight(distances[k], scale);
  }
  return plane;
}

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

SurfaceSample sample_surface(const Eigen::Matrix3Xd& points, int most_points, int most_normals) {
  if (points.cols() < 12) throw std::invalid_argument("sample_surface: fewer than 12 points");
  SurfaceSample sample;
  EvenSample<Eigen::Index> kept(static_cast<std::size_t>(most_points));
  for (Eigen::Index k = 0; k < points.cols(); ++k) kept.add([&] { return k; });
  const auto N = static_cast<Eigen::Index>(kept.values().size());
  sample.points.resize(3, N);
  for (Eigen::Index k = 0; k < N; ++k) sample.points.col(k) = points.col(kept.values()[static_cast<std::size_t>(k)]);

  const NearestPoints tree(sample.points);
  const int few = static_cast<int>(std::min<Eigen::Index>(9, N));  // the point itself is one
  std::vector<double> distances;
  distances.reserve(static_cast<std::size_t>(N));
  for (Eigen::Index k = 0; k < N; ++k)
    distances.push_back(std::sqrt(tree.nearest(sample.points.col(k), few).back().distance_squared));
  const double usual = median(distances);
  sample.weights.resize(N);
  std::vector<Eigen::Index> members;
  for (Eigen::Index k = 0; k < N; ++k) {
    sample.weights[k] = distances[static_cast<std::size_t>(k)] <= 4 * usual;
    if (sample.weights[k] > 0) members.push_back(k);
  }

  // Planes at so many of the members, evenly.
  const auto planes_at = [&](std::size_t places, int count) {
    std::vector<Plane> planes(places);
    for (std::size_t a = 0; a < places; ++a) {
      const Eigen::Index k = members[a * members.size() / places];
      planes[a] = plane_through(sample.points, tree.nearest(sample.points.col(k), count));
    }
    return planes;
  };
  const auto anchors = std::min<std::size_t>(members.size(), static_cast<std::size_t>(most_normals));
  for (int count = static_cast<int>(std::min<Eigen::Index>(12, N));; count *= 2) {
    std::vector<double> deviations, widths;
    for (const Plane& plane : planes_at(std::min(anchors, kDeciding), count)) {
      deviations.push_back(plane.deviation);
      widths.push_back(plane.width);
    }
    const double deviation = median(deviations), width = median(widths);
    if (sample.neighbours > 0 && deviation > 1.4 * sample.noise_mm) break;  // they bend: the last ones were better
    sample.neighbours = count;
    sample.noise_mm = deviation;
    sample.normal_noise_rad = width > 0 ? deviation / (width * std::sqrt(static_cast<double>(count))) : 0;
    if (sample.normal_noise_rad <= 0.01 && width >= 3 * deviation) break;
    if (2 * count > N / 6) break;
  }
  const std::vector<Plane> planes = planes_at(anchors, sample.neighbours);
  sample.middles.resize(3, static_cast<Eigen::Index>(anchors));
  sample.normals = sample.middles;
  sample.normal_weights.resize(static_cast<Eigen::Index>(anchors));
  for (std::size_t a = 0; a < anchors; ++a) {
    const auto column = static_cast<Eigen::Index>(a);
    sample.middles.col(column) = planes[a].middle;
    sample.normals.col(column) = planes[a].normal;
    sample.normal_weights[column] = planes[a].deviation < 0.7 * planes[a].width;
  }
  return sample;
}

}  // namespace celadon
