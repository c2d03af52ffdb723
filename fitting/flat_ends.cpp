#include "fitting/flat_ends.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "fitting/robust_least_squares.h"
#include "fitting/surface_sample.h"

namespace celadon {
namespace {

constexpr int kPoints = 12000, kNormals = 4000;
constexpr double kFlat = 0.94;        // |cos| of a normal that may be a face's: 20 degrees from the axis
constexpr double kSteepest = 0.27;    // slope of a face: 15 degrees
constexpr double kLeastShare = 0.01;  // of the normals
constexpr double kMostBeyond = 0.02;  // of the other points, on the outer side
constexpr double kLeastWidth = 0.15;  // of the wall's radius, that a face extends over
constexpr double kScales = 5;         // of a face's scatter, that are the face
constexpr double kRounding = 1e-5;    // of the height, below which scatter counts as none
constexpr int kCandidates = 6, kRounds = 20;

double value_at_share(std::vector<double> values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

struct Plane {
  Eigen::Vector3d coefficients;  // of 1, x, y
  double above(const Eigen::Vector3d& p) const { return p.z() - coefficients.dot(Eigen::Vector3d(1, p.x(), p.y())); }
};

// One step of reweighted least squares.
void refit(Plane& plane, const std::vector<Eigen::Vector3d>& points, double scale) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : points) {
    const double w = tukey_weight(plane.above(p), scale);
    const Eigen::Vector3d row(1, p.x(), p.y());
    A += w * row * row.transpose();
    b += w * p.z() * row;
  }
  plane.coefficients = A.completeOrthogonalDecomposition().solve(b);
}

// From the points within `near` of a height.
Plane fit_plane(const std::vector<Eigen::Vector3d>& points, double height, double near, double least_scale) {
  Plane plane{{height, 0, 0}};
  double scale = near;
  for (int round = 0; round < kRounds; ++round) {
    refit(plane, points, scale);
    scale = std::max(least_scale, 0.7 * scale);
  }
  return plane;
}

// The height within whose window most of them lie; they are sorted.
double densest(const std::vector<double>& heights, double window) {
  double best = heights.front();
  std::size_t most = 0;
  for (std::size_t lo = 0, hi = 0; lo < heights.size(); ++lo) {
    while (hi < heights.size() && heights[hi] <= heights[lo] + window) ++hi;
    if (hi - lo > most) most = hi - lo, best = heights[lo] + window / 2;
  }
  return best;
}

// How far a paraboloid through the face's points rises over them.
double sag(const std::vector<Eigen::Vector3d>& points) {
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for (const auto& p : points) middle += p.head<2>() / static_cast<double>(points.size());
  std::vector<double> squares;
  Eigen::MatrixX4d rows(static_cast<Eigen::Index>(points.size()), 4);
  Eigen::VectorXd z(rows.rows());
  for (std::size_t k = 0; k < points.size(); ++k) {
    const Eigen::Vector2d q = points[k].head<2>() - middle;
    squares.push_back(q.squaredNorm());
    rows.row(static_cast<Eigen::Index>(k)) << 1, q.x(), q.y(), q.squaredNorm();
    z[static_cast<Eigen::Index>(k)] = points[k].z();
  }
  const Eigen::VectorXd c = rows.colPivHouseholderQr().solve(z);
  return std::abs(c[3]) * (value_at_share(squares, 0.95) - value_at_share(squares, 0.05));
}

struct Face {
  FlatEnd end;
  bool upper = false;
};

// The flat normals' places on one plane, which are taken out; nullopt: they are no end of the body.
std::optional<Face> take_face(std::vector<Eigen::Vector3d>& flats, const SurfaceSample& sample, double noise,
                              double wall_radius, double all_normals) {
  std::vector<double> heights;
  for (const auto& p : flats) heights.push_back(p.z());
  std::sort(heights.begin(), heights.end());
  const double window = 6 * noise;
  Plane plane = fit_plane(flats, densest(heights, window), 10 * window, noise);
  std::vector<Eigen::Vector3d> members, others;
  for (const auto& p : flats) (std::abs(plane.above(p)) <= 3 * noise ? members : others).push_back(p);
  if (members.empty()) {
    flats.clear();
    return std::nullopt;
  }
  flats = std::move(others);
  if (static_cast<double>(members.size()) < std::max(20.0, kLeastShare * all_normals)) return std::nullopt;
  const Eigen::Vector2d slope = plane.coefficients.tail<2>();
  if (slope.norm() > kSteepest || sag(members) > 2 * noise) return std::nullopt;
  std::vector<double> radii;
  for (const auto& p : members) radii.push_back(p.head<2>().norm());
  if (value_at_share(radii, 0.95) - value_at_share(radii, 0.05) < kLeastWidth * wall_radius) return std::nullopt;

  // Once more from points where no wall is near, down to their own scatter; and what lies on either side.
  std::vector<Eigen::Vector3d> own;
  double above = 0, below = 0, on = 0;
  for (Eigen::Index k = 0; k < sample.points.cols(); ++k) {
    const Eigen::Vector3d p = sample.points.col(k);
    const double d = plane.above(p);
    if (std::abs(d) <= 4 * noise) {
      ++on;
      if (std::abs(p.head<2>().norm() - wall_radius) > 0.1 * wall_radius) own.push_back(p);
    } else {
      ++(d > 0 ? above : below);
    }
  }
  if (own.size() < 3) return std::nullopt;
  double scatter = 0;
  for (int round = 0; round < kRounds; ++round) {
    std::vector<double> distances;
    for (const auto& p : own) distances.push_back(std::abs(plane.above(p)));
    scatter = std::max(1.4826 * value_at_share(distances, 0.5), kRounding * wall_radius / kScales);
    refit(plane, own, scatter);
  }
  Face face;
  face.upper = above < below;
  if ((face.upper ? above : below) > kMostBeyond * (above + below)) return std::nullopt;
  face.end.height_mm = plane.coefficients[0];
  face.end.slope = plane.coefficients.tail<2>();
  face.end.half_width_mm = kScales * scatter;
  face.end.share = on / static_cast<double>(sample.points.cols());
  return face;
}

}  // namespace

double FlatEnd::tilt_rad() const {
  return std::atan(slope.norm());
}

bool FlatEnds::hide(double x, double y, double z) const {
  const auto over = [&](const FlatEnd& end) { return z - end.height_mm - end.slope.dot(Eigen::Vector2d(x, y)); };
  return (lower && over(*lower) < lower->half_width_mm) || (upper && over(*upper) > -upper->half_width_mm);
}

FlatEnds find_flat_ends(const Eigen::Matrix3Xd& points) {
  FlatEnds ends;
  if (points.cols() < 200) return ends;
  const SurfaceSample sample = sample_surface(points, kPoints, kNormals);
  std::vector<Eigen::Vector3d> flats;
  std::vector<double> radii;
  double normals = 0;
  for (Eigen::Index k = 0; k < sample.normals.cols(); ++k) {
    if (sample.normal_weights[k] <= 0) continue;
    ++normals;
    if (std::abs(sample.normals(2, k)) > kFlat) {
      flats.emplace_back(sample.middles.col(k));
    } else {
      radii.push_back(sample.middles.col(k).head<2>().norm());
    }
  }
  if (radii.size() < 20) return ends;
  const double wall_radius = value_at_share(radii, 0.5), noise = std::max(sample.noise_mm, kRounding * wall_radius);
  for (int k = 0; k < kCandidates && flats.size() >= 20; ++k) {
    const auto face = take_face(flats, sample, noise, wall_radius, normals);
    if (!face) continue;
    auto& end = face->upper ? ends.upper : ends.lower;
    if (!end) end = face->end;
  }
  return ends;
}

const Profile* WallStream::next() {
  const Profile* const all = from_.next();
  if (!all) return nullptr;
  profile_ = *all;
  std::size_t kept = 0;
  for (std::size_t k = 0; k < all->size(); ++k) {
    const double r = all->r_mm[k], t = all->theta_rad[k];
    if (ends_.hide(r * std::cos(t), r * std::sin(t), all->z_mm[k])) continue;
    profile_.r_mm[kept] = r;
    profile_.theta_rad[kept] = t;
    profile_.z_mm[kept] = all->z_mm[k];
    if (!all->covariance.empty()) profile_.covariance[kept] = all->covariance[k];
    if (!all->row.empty()) profile_.row[kept] = all->row[k];
    ++kept;
  }
  profile_.r_mm.resize(kept);
  profile_.theta_rad.resize(kept);
  profile_.z_mm.resize(kept);
  if (!all->covariance.empty()) profile_.covariance.resize(kept);
  if (!all->row.empty()) profile_.row.resize(kept);
  return &profile_;
}

}  // namespace celadon
