// Formulas: README.md, "Triangulation".
#include "acquisition/triangulation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>

namespace celadon {
namespace {

/// Positions are stored as floats: below this a standard deviation is a statement about rounding.
constexpr double kSmallestSigmaPx = 1e-4;
/// A line breaks where it steps by more than this beyond what its slope explains.
constexpr float kEdgeJump_px = 4;
/// The angle is asked for at instants this far apart and taken as linear between: at 10 rad/s^2 that is 3e-7 rad.
constexpr double kAngleStepNs = 500'000;
/// Rows without a line that a run passes over: single speckle grains, not edges.
constexpr std::size_t kLongestDropout = 2;

bool has_position(const LineRow& row, int length_px) {
  return (row.status == RowStatus::found || row.status == RowStatus::saturated) && row.x_px >= -0.5f &&
         row.x_px <= static_cast<float>(length_px) - 0.5f && std::isfinite(row.sigma_px);
}

/// Rows that lie beside a jump or a gap of the line, as flags. A jump is a step between two neighbours that exceeds the
/// steps before and after it: a steep line steps evenly.
std::vector<bool> edge_rows(std::span<const LineRow> rows, int length_px) {
  std::vector<std::size_t> on;
  on.reserve(rows.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (has_position(rows[i], length_px)) on.push_back(i);
  }
  const auto apart = [&](std::size_t k) { return static_cast<float>(on[k + 1] - on[k]); };
  const auto step = [&](std::size_t k) { return rows[on[k + 1]].x_px - rows[on[k]].x_px; };
  const auto gap = [&](std::size_t k) { return on[k + 1] - on[k] > kLongestDropout + 1; };
  std::vector<bool> edge(rows.size(), false);
  for (std::size_t k = 0; k + 1 < on.size(); ++k) {
    bool breaks = gap(k);
    if (!breaks) {
      const bool has_left = k > 0 && !gap(k - 1), has_right = k + 2 < on.size() && !gap(k + 1);
      const float left = has_left ? step(k - 1) / apart(k - 1) : 0, right = has_right ? step(k + 1) / apart(k + 1) : 0;
      // The gentler neighbour: the steeper one may be a break itself.
      const bool use_left = has_left && (!has_right || std::abs(left) < std::abs(right));
      const float expected = (use_left ? left : right) * apart(k);
      breaks = std::abs(step(k) - expected) > kEdgeJump_px + std::abs(expected);
    }
    if (breaks) edge[on[k]] = edge[on[k + 1]] = true;
  }
  return edge;
}

double wrapped(double angle_rad) {
  constexpr double kTurn = 2 * std::numbers::pi;
  const double out = angle_rad - kTurn * std::floor(angle_rad / kTurn);
  return out < kTurn ? out : 0;
}

}  // namespace

LineAlong line_along(const LaserPlane& plane) {
  // depth = distance / (normal . (a, b, 1)): a pixel to the right changes it by the normal's x, one downward by its y.
  return std::abs(plane.normal_C.x()) >= std::abs(plane.normal_C.y()) ? LineAlong::rows : LineAlong::columns;
}

Triangulator::Triangulator(const Calibration& calibration, int laser, const ScanVolume& volume, LineAlong along,
                           const AxisStop& stop)
    : lens_(calibration.camera_model),
      along_(along),
      width_px_(calibration.camera_model.width_px),
      height_px_(calibration.camera_model.height_px),
      volume_(volume),
      encoder_(calibration.encoder),
      time_(calibration.time) {
  const auto plane = std::find_if(calibration.lasers.begin(), calibration.lasers.end(),
                                  [&](const LaserPlane& candidate) { return candidate.laser == laser; });
  if (plane == calibration.lasers.end()) {
    throw std::invalid_argument("Triangulator: the calibration has no laser " + std::to_string(laser));
  }
  if (!(volume.r_min_mm > 0 && volume.r_min_mm < volume.r_max_mm && volume.z_min_mm < volume.z_max_mm)) {
    throw std::invalid_argument("Triangulator: the scan volume is empty, or holds the axis");
  }
  normal_C_ = plane->normal_C;
  distance_mm_ = plane->distance_mm;
  const Eigen::Affine3d X_WC = camera_to_object(calibration, stop);
  R_WC_ = X_WC.linear();
  p_WC_ = X_WC.translation();
}

std::int64_t Triangulator::row_instant_ns(const FrameInfo& frame, double row) const {
  return frame.stamp_ns + std::llround(time_.stamp_offset_ns.value +
                                       time_.exposure_factor.value * static_cast<double>(frame.exposure_ns) +
                                       row * time_.line_time_ns.value);
}

bool Triangulator::meets_radius(double x_px, double row_px, double r_mm) const {
  const UndistortedPoint ray = lens_.undistort(x_px, row_px);
  const Eigen::Vector3d d = R_WC_ * Eigen::Vector3d(ray.a, ray.b, 1);
  const double off = p_WC_.x() * d.y() - p_WC_.y() * d.x();
  return off * off <= r_mm * r_mm * (d.x() * d.x() + d.y() * d.y());
}

Triangulator::Point Triangulator::point(double x_px, double row_px) const {
  const UndistortedPoint ray = lens_.undistort(x_px, row_px);
  // Along (a, b, 1) the plane lies at depth = distance / (normal . ray); its derivative follows from that.
  const double slant = normal_C_.x() * ray.a + normal_C_.y() * ray.b + normal_C_.z();
  const double depth = distance_mm_ / slant;
  Point out;
  if (!(depth > 0) || !std::isfinite(depth)) return out;
  const Eigen::Vector3d direction(ray.a, ray.b, 1);
  const double a_by_px = along_ == LineAlong::rows ? ray.a_by_x : ray.a_by_y;
  const double b_by_px = along_ == LineAlong::rows ? ray.b_by_x : ray.b_by_y;
  const double depth_by_px = -depth / slant * (normal_C_.x() * a_by_px + normal_C_.y() * b_by_px);
  const Eigen::Vector3d p_W = R_WC_ * (depth * direction) + p_WC_;
  const Eigen::Vector3d p_W_by_px = R_WC_ * (depth_by_px * direction + depth * Eigen::Vector3d(a_by_px, b_by_px, 0));
  const double rr = p_W.x() * p_W.x() + p_W.y() * p_W.y();
  out.r_mm = std::sqrt(rr);
  out.z_mm = p_W.z();
  out.inside = out.r_mm >= volume_.r_min_mm && out.r_mm <= volume_.r_max_mm && out.z_mm >= volume_.z_min_mm &&
               out.z_mm <= volume_.z_max_mm;
  if (!out.inside) return out;
  out.theta_rad = std::atan2(p_W.y(), p_W.x());
  out.r_by_px = (p_W.x() * p_W_by_px.x() + p_W.y() * p_W_by_px.y()) / out.r_mm;
  out.theta_by_px = (p_W.x() * p_W_by_px.y() - p_W.y() * p_W_by_px.x()) / rr;
  out.z_by_px = p_W_by_px.z();
  return out;
}

Triangulator::Counts Triangulator::triangulate(std::span<const LineRow> rows, const FrameInfo& frame,
                                               AngleAtRef angle_at, Profile& profile) const {
  if (rows.size() > std::numeric_limits<std::uint16_t>::max()) {
    throw std::invalid_argument("Triangulator: an image has at most 65535 rows");
  }
  profile.r_mm.clear();
  profile.theta_rad.clear();
  profile.z_mm.clear();
  profile.covariance.clear();
  profile.row.clear();

  // Of the image: along columns it is the position that tells a sample's row, and with it the instant.
  const std::size_t image_rows = along_ == LineAlong::rows ? rows.size() : static_cast<std::size_t>(height_px_);
  const double middle_row = 0.5 * (static_cast<double>(image_rows) - 1);
  profile.time_ns = row_instant_ns(frame, middle_row);
  const Angle middle = angle_at(profile.time_ns);
  profile.table_angle_rad = middle ? encoder_.table_rad(middle->angle_rad) : 0;

  // Rows that share two instants of the table's motion.
  const double line_time_ns = std::abs(time_.line_time_ns.value);
  const std::size_t block = line_time_ns * static_cast<double>(image_rows) <= kAngleStepNs
                                ? std::max<std::size_t>(image_rows, 1)
                                : std::max<std::size_t>(static_cast<std::size_t>(kAngleStepNs / line_time_ns), 1);
  std::vector<Angle> angles;
  std::vector<double> block_rad;  // of the table
  for (std::size_t first = 0; first < image_rows + block; first += block) {
    angles.push_back(line_time_ns == 0 ? middle : angle_at(row_instant_ns(frame, static_cast<double>(first))));
    block_rad.push_back(angles.back() ? encoder_.table_rad(angles.back()->angle_rad) : 0);
  }

  const double rate = middle ? encoder_.rate(middle->angle_rad) : encoder_.direction * encoder_.scale.value;

  Counts counts;
  const int length_px = along_ == LineAlong::rows ? width_px_ : height_px_;
  const std::vector<bool> edge = edge_rows(rows, length_px);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const LineRow& row = rows[i];
    counts.ambiguous += row.status == RowStatus::ambiguous;
    if (!has_position(row, length_px)) continue;
    if (edge[i]) {
      ++counts.edge;
      continue;
    }
    const double position_px = row.x_px, number_px = static_cast<double>(i);
    const double image_row = along_ == LineAlong::rows ? number_px : position_px;
    const Point p = along_ == LineAlong::rows ? point(position_px, number_px) : point(number_px, position_px);
    if (!p.inside) {
      ++counts.outside;
      continue;
    }
    const auto at = static_cast<std::size_t>(std::max(image_row, 0.)) / block;
    const Angle &before = angles[at], &after = angles[at + 1];
    if (!before || !after) {
      ++counts.no_angle;
      continue;
    }
    const double share = (image_row - static_cast<double>(at * block)) / static_cast<double>(block);
    const double table_rad = block_rad[at] + share * (block_rad[at + 1] - block_rad[at]);
    const double sigma_px = std::max<double>(row.sigma_px, kSmallestSigmaPx), variance_px = sigma_px * sigma_px;
    // The table turns by `smear` while the row is exposed; where in it the light came from is unknown.
    const double sigma_turn = rate * std::max(before->sigma_rad, after->sigma_rad);
    const double smear = rate * before->speed_rad_per_s * static_cast<double>(frame.exposure_ns) * 1e-9;
    const double turn_variance = sigma_turn * sigma_turn + smear * smear / 12;
    // Along columns another position is another row, at another angle.
    const double theta_by_px = along_ == LineAlong::rows
                                   ? p.theta_by_px
                                   : p.theta_by_px - rate * before->speed_rad_per_s * 1e-9 * time_.line_time_ns.value;
    profile.r_mm.push_back(p.r_mm);
    profile.theta_rad.push_back(wrapped(p.theta_rad - table_rad));
    profile.z_mm.push_back(p.z_mm);
    profile.covariance.push_back({.rr = static_cast<float>(p.r_by_px * p.r_by_px * variance_px),
                                  .rt = static_cast<float>(p.r_by_px * theta_by_px * variance_px),
                                  .rz = static_cast<float>(p.r_by_px * p.z_by_px * variance_px),
                                  .tt = static_cast<float>(theta_by_px * theta_by_px * variance_px + turn_variance),
                                  .tz = static_cast<float>(theta_by_px * p.z_by_px * variance_px),
                                  .zz = static_cast<float>(p.z_by_px * p.z_by_px * variance_px)});
    profile.row.push_back(static_cast<std::uint16_t>(i));
    ++counts.found;
  }
  return counts;
}

}  // namespace celadon
