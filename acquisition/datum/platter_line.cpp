#include "acquisition/datum/platter_line.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "acquisition/lens.h"

namespace celadon {
namespace {

using Eigen::Vector3d;

constexpr double kFarthest_mm = 400, kProbe_px = 0.5;

}  // namespace

PlatterLine::PlatterLine(const Calibration& calibration, int laser, LineAlong along) : laser_(laser) {
  const auto plane = std::find_if(calibration.lasers.begin(), calibration.lasers.end(),
                                  [&](const LaserPlane& candidate) { return candidate.laser == laser; });
  if (plane == calibration.lasers.end()) {
    throw std::invalid_argument("PlatterLine: the calibration has no laser " + std::to_string(laser));
  }
  const CameraModel& camera = calibration.camera_model;
  const Lens lens(camera);
  const Eigen::Isometry3d X_WC = calibration.axis.X_CW.inverse();
  const bool rows = along == LineAlong::rows;
  const int lines = rows ? camera.height_px : camera.width_px, length = rows ? camera.width_px : camera.height_px;
  const auto point = [&](double at, int line) -> Vector3d {  // NaN: the ray does not meet the plane
    const UndistortedPoint ray = rows ? lens.undistort(at, line) : lens.undistort(line, at);
    const Vector3d direction(ray.a, ray.b, 1);
    const double depth = plane->distance_mm / plane->normal_C.dot(direction);
    if (!(depth > 0)) return Vector3d::Constant(NAN);
    return calibration.scale.value * (X_WC * (depth * direction));
  };
  rows_.resize(static_cast<std::size_t>(lines));
  for (int line = 0; line < lines; ++line) {
    // The height along a row changes nearly evenly: secants find its zero.
    double x = 0.5 * length, z_by_px = 0;
    Vector3d p = Vector3d::Zero();
    for (int step = 0; step < 20; ++step) {
      p = point(x, line);
      z_by_px = (point(x + kProbe_px, line).z() - p.z()) / kProbe_px;
      const double by = p.z() / z_by_px;
      if (!std::isfinite(by)) break;
      x -= std::clamp(by, -0.25 * length, 0.25 * length);
      if (std::abs(by) < 1e-6) break;
    }
    if (!(std::abs(p.z()) < 1e-3) || !(x >= 0 && x <= length - 1)) continue;
    const double r = p.head<2>().norm();
    if (r > kFarthest_mm) continue;
    rows_[static_cast<std::size_t>(line)] = {x, r, z_by_px, 0, 0, 0};
  }
}

void PlatterLine::add(std::span<const LineRow> rows) {
  ++frames_;
  const std::size_t n = std::min(rows.size(), rows_.size());
  for (std::size_t k = 0; k < n; ++k) {
    Row& row = rows_[k];
    if (row.r_mm == 0 || (rows[k].status != RowStatus::found && rows[k].status != RowStatus::saturated)) continue;
    const double off = static_cast<double>(rows[k].x_px) - row.x_px;
    if (!(std::abs(off * row.z_by_px) <= kReach_mm)) continue;
    ++row.count;
    row.sum_px += off;
    row.sum_squares += off * off;
  }
}

std::vector<PlatterHeight> PlatterLine::heights(double beyond_mm) const {
  std::vector<PlatterHeight> out;
  for (const Row& row : rows_) {
    if (row.r_mm <= beyond_mm || row.count < 2 || 4 * row.count < frames_) continue;
    const double mean = row.sum_px / row.count,
                 variance = std::max(0., row.sum_squares / row.count - mean * mean) * row.count / (row.count - 1);
    out.push_back({row.r_mm, mean * row.z_by_px, std::abs(row.z_by_px) * std::sqrt(variance / row.count), row.count});
  }
  return out;
}

}  // namespace celadon
