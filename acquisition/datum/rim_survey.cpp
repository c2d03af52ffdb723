#include "acquisition/datum/rim_survey.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <optional>

#include "acquisition/lens.h"

namespace celadon {
namespace {

using Eigen::Vector3d;

constexpr std::size_t kFewestViews = 3;
constexpr double kSmallestU_mm = 0.002, kNotSquare = 0.05, kFarOff = 5;

struct PlatterRay {
  Vector3d origin_mm, direction;  ///< scanner frame at table angle 0
};

struct NearestPoint {
  Vector3d p_mm;
  double u_mm = 0;
};

double miss_mm(const PlatterRay& ray, const Vector3d& p_mm) {
  const Vector3d to = p_mm - ray.origin_mm;
  return (to - to.dot(ray.direction) * ray.direction).norm();
}

std::optional<Vector3d> nearest(std::span<const PlatterRay> rays) {
  Eigen::Matrix3d N = Eigen::Matrix3d::Zero();
  Vector3d b = Vector3d::Zero();
  for (const PlatterRay& ray : rays) {
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - ray.direction * ray.direction.transpose();
    N += across;
    b += across * ray.origin_mm;
  }
  const Eigen::LDLT<Eigen::Matrix3d> solver(N);
  // Rays that are nearly parallel meet nowhere in particular.
  if (!(solver.vectorD().minCoeff() > 1e-3 * static_cast<double>(rays.size()))) return std::nullopt;
  return solver.solve(b);
}

std::optional<NearestPoint> meet(std::vector<PlatterRay> rays) {
  for (int round = 0; round < 3; ++round) {
    if (rays.size() < kFewestViews) return std::nullopt;
    const auto p = nearest(rays);
    if (!p) return std::nullopt;
    std::vector<double> misses;
    double sum = 0;
    for (const PlatterRay& ray : rays) {
      misses.push_back(miss_mm(ray, *p));
      sum += misses.back() * misses.back();
    }
    std::vector<double> sorted = misses;
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2), sorted.end());
    const double limit_mm = kFarOff * std::max(sorted[sorted.size() / 2], kSmallestU_mm);
    std::vector<PlatterRay> kept;
    for (std::size_t k = 0; k < rays.size(); ++k) {
      if (misses[k] <= limit_mm) kept.push_back(rays[k]);
    }
    if (kept.size() == rays.size()) {
      // Two numbers a ray, three unknowns.
      const double freedom = 2 * static_cast<double>(rays.size()) - 3;
      return NearestPoint{*p, std::max(kSmallestU_mm, std::sqrt(sum / freedom / static_cast<double>(rays.size())))};
    }
    rays = std::move(kept);
  }
  return std::nullopt;
}

bool is_square(const RimTag& tag) {
  const auto& c = tag.corners_mm;
  const double diagonal = 0.5 * ((c[2] - c[0]).norm() + (c[3] - c[1]).norm()), side = diagonal / std::sqrt(2.);
  for (std::size_t k = 0; k < 4; ++k) {
    if (std::abs((c[(k + 1) % 4] - c[k]).norm() - side) > kNotSquare * side) return false;
  }
  return std::abs((c[2] - c[0]).norm() - diagonal) <= kNotSquare * diagonal;
}

}  // namespace

std::vector<RimTag> survey_rim(const Calibration& calibration, std::span<const RimView> views) {
  const Lens lens(calibration.camera_model);
  const Eigen::Isometry3d X_WC = calibration.axis.X_CW.inverse();
  std::map<int, std::array<std::vector<PlatterRay>, 4>> rays;
  for (const RimView& view : views) {
    const Eigen::Matrix3d back =
        Eigen::AngleAxisd(-calibration.encoder.table_rad(view.encoder_rad), Vector3d::UnitZ()).toRotationMatrix();
    for (const SeenTag& tag : view.tags) {
      for (std::size_t k = 0; k < 4; ++k) {
        const UndistortedPoint ray = lens.undistort(tag.corners_px[k].x(), tag.corners_px[k].y());
        rays[tag.number][k].push_back({back * X_WC.translation() * calibration.scale.value,
                                       back * (X_WC.linear() * Vector3d(ray.a, ray.b, 1)).normalized()});
      }
    }
  }
  std::vector<RimTag> tags;
  for (const auto& [number, of_corners] : rays) {
    RimTag tag{number, {}, 0};
    bool known = true;
    for (std::size_t k = 0; k < 4 && known; ++k) {
      const auto met = meet(of_corners[k]);
      known = met.has_value();
      if (!known) break;
      tag.corners_mm[k] = met->p_mm;
      tag.u_mm = std::max(tag.u_mm, met->u_mm);
    }
    if (known && is_square(tag)) tags.push_back(tag);
  }
  return tags;
}

}  // namespace celadon
