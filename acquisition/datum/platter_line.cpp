#include "acquisition/datum/platter_line.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string>

#include "acquisition/lens.h"

namespace celadon {
namespace {

using Eigen::Vector3d;

constexpr double kFarthest_mm = 400, kProbe_px = 0.5;
// Pixels of a row: of the line's peak, and of what lies beside it on either side, from there on.
constexpr std::ptrdiff_t kPeak_px = 5, kBeside_px = 4, kNeeded_px = kPeak_px + kBeside_px;
constexpr double kMostReach_px = 48;
constexpr std::size_t kTogether = 4;  // rows, whose mean shows the line where it is too dark for one
constexpr double kLineShare = 0.65;   // of a peak's height that a line loses within kPeak_px; reflections are broader
constexpr double kLeastPeak = 6;      // standard deviations of the sum over the peak

struct Found {
  double at_px = 0, sd_px = 0;
};

/// The line in a row of means, counted from its first pixel: the centroid about the highest place, over the straight
/// line through what lies on both sides.
std::optional<Found> find_line(std::span<const double> mean) {
  const auto n = static_cast<std::ptrdiff_t>(mean.size());
  std::vector<double> steps;
  for (std::ptrdiff_t i = 0; i + 1 < n; ++i) {
    steps.push_back(std::abs(mean[static_cast<std::size_t>(i + 1)] - mean[static_cast<std::size_t>(i)]));
  }
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  const double noise = *middle * 1.4826 / std::numbers::sqrt2;

  const auto sum = [&](std::ptrdiff_t from, std::ptrdiff_t to) {
    double total = 0;
    for (std::ptrdiff_t i = from; i < to; ++i) total += mean[static_cast<std::size_t>(i)];
    return total;
  };
  const auto left = [&](std::ptrdiff_t at) { return sum(at - kNeeded_px, at - kPeak_px) / kBeside_px; };
  const auto right = [&](std::ptrdiff_t at) { return sum(at + kPeak_px + 1, at + kNeeded_px + 1) / kBeside_px; };
  constexpr std::ptrdiff_t kWidth = 2 * kPeak_px + 1;
  const auto over = [&](std::ptrdiff_t at) {
    return sum(at - kPeak_px, at + kPeak_px + 1) - kWidth * (left(at) + right(at)) / 2;
  };
  std::ptrdiff_t best = -1;
  for (std::ptrdiff_t at = kNeeded_px; at + kNeeded_px < n; ++at) {
    if (best < 0 || over(at) > over(best)) best = at;
  }
  const double by_noise = std::sqrt(kWidth + kWidth * kWidth / (2. * kBeside_px));
  if (best < 0 || over(best) < kLeastPeak * noise * by_noise) return std::nullopt;
  const double top = sum(best - 1, best + 2) / 3, far = (left(best) + right(best)) / 2,
               near = (sum(best - kPeak_px, best - kPeak_px + 2) + sum(best + kPeak_px - 1, best + kPeak_px + 1)) / 4;
  if (top - near < kLineShare * (top - far)) return std::nullopt;
  const double low = left(best), slope = (right(best) - low) / (2 * kPeak_px + kBeside_px + 1),
               start = static_cast<double>(best) - kPeak_px - 0.5 * (kBeside_px + 1);
  double weight = 0, moment = 0, squares = 0;
  for (std::ptrdiff_t i = best - kPeak_px; i <= best + kPeak_px; ++i) {
    const double x = static_cast<double>(i - best);
    const double w = mean[static_cast<std::size_t>(i)] - low - slope * (static_cast<double>(i) - start);
    weight += w, moment += w * x, squares += x * x;
  }
  if (!(weight > 0)) return std::nullopt;
  return Found{static_cast<double>(best) + moment / weight, noise * std::sqrt(squares) / weight};
}

}  // namespace

PlatterLine::PlatterLine(const Calibration& calibration, int laser, LineAlong along) : laser_(laser), along_(along) {
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
    const double reach = std::min(kReach_mm / std::abs(z_by_px) + kNeeded_px, kMostReach_px);
    const auto first = static_cast<std::size_t>(std::max(0., std::floor(x - reach))),
               end = static_cast<std::size_t>(std::min<double>(length, std::ceil(x + reach) + 1));
    if (end - first <= 2 * kNeeded_px) continue;
    rows_[static_cast<std::size_t>(line)] = {x, r, z_by_px, first, end - first, sums_.size()};
    sums_.resize(sums_.size() + end - first);
  }
}

void PlatterLine::add(const CameraMode& mode, std::span<const std::uint8_t> picture,
                      std::span<const std::uint8_t> dark) {
  ++frames_;
  const std::size_t pixel = bytes_per_pixel(mode.format);
  const std::size_t along_row = along_ == LineAlong::rows ? pixel : mode.stride_bytes,
                    to_next = along_ == LineAlong::rows ? mode.stride_bytes : pixel;
  for (std::size_t line = 0; line < rows_.size(); ++line) {
    const Row& row = rows_[line];
    if (row.r_mm == 0) continue;
    std::size_t at = line * to_next + row.first_px * along_row;
    for (std::size_t k = 0; k < row.count_px; ++k, at += along_row) {
      sums_[row.first_sum + k] += picture[at] - (dark.empty() ? 0 : dark[at]);
    }
  }
}

// Rows are laid on each other by where the line is expected: a whole number of pixels, and the rest on average.
std::optional<PlatterHeight> PlatterLine::height(std::span<const Row> rows) const {
  std::ptrdiff_t reach = std::numeric_limits<std::ptrdiff_t>::max();
  PlatterHeight mean;
  double z_by_px = 0, rest_px = 0;
  const auto n = static_cast<double>(rows.size());
  const auto middle_of = [](const Row& row) {
    return std::lround(row.x_px) - static_cast<std::ptrdiff_t>(row.first_px);
  };
  for (const Row& row : rows) {
    const std::ptrdiff_t middle = middle_of(row);
    reach = std::min({reach, middle, static_cast<std::ptrdiff_t>(row.count_px) - 1 - middle});
    mean.r_mm += row.r_mm / n;
    z_by_px += row.z_by_px / n;
    rest_px += (row.x_px - std::round(row.x_px)) / n;
  }
  if (reach < kNeeded_px) return std::nullopt;
  std::vector<double> together(static_cast<std::size_t>(2 * reach + 1));
  for (const Row& row : rows) {
    const std::size_t first = row.first_sum + static_cast<std::size_t>(middle_of(row) - reach);
    for (std::size_t k = 0; k < together.size(); ++k) together[k] += sums_[first + k] / (n * frames_);
  }
  const auto found = find_line(together);
  if (!found) return std::nullopt;
  mean.z_mm = (found->at_px - static_cast<double>(reach) - rest_px) * z_by_px;
  mean.sd_mm = std::abs(z_by_px) * found->sd_px;
  if (!(std::abs(mean.z_mm) <= kReach_mm)) return std::nullopt;
  return mean;
}

std::vector<PlatterHeight> PlatterLine::heights(double beyond_mm) const {
  std::vector<PlatterHeight> out;
  if (frames_ == 0) return out;
  const auto usable = [&](const Row& row) { return row.r_mm > beyond_mm; };
  for (std::size_t first = 0; first < rows_.size();) {
    std::size_t end = first;
    while (end < rows_.size() && end - first < kTogether && usable(rows_[end])) ++end;
    if (end - first == kTogether) {
      if (const auto height_there = height(std::span(rows_).subspan(first, kTogether))) out.push_back(*height_there);
    }
    first = std::max(end, first + 1);
  }
  return out;
}

}  // namespace celadon
