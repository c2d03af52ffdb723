// Smoothing along the line, for gating and preview. README.md, "Line extraction", step 7.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <vector>

#include "acquisition/laser_line.h"

namespace celadon {

namespace {

constexpr int kReachRows = 8;
constexpr int kLongestGapRows = 4;  ///< a longer gap ends a run
constexpr int kFewestRows = 5;      ///< a shorter run is no evidence of a line
constexpr double kJumpPx = 2.0;     ///< beside the local slope, more than noise and curvature make in one row
constexpr double kSlopeAllowance = 0.5;
constexpr double kWindowRows = 3.5;  ///< standard deviation of the weights along the line

struct Point {
  int row = 0;
  double x = 0, amplitude = 0;
};

/// Slopes (px per row) between neighbouring points.
std::vector<double> steps_of(const std::vector<Point>& points) {
  std::vector<double> steps;
  for (std::size_t i = 0; i + 1 < points.size(); ++i) {
    steps.push_back((points[i + 1].x - points[i].x) / (points[i + 1].row - points[i].row));
  }
  return steps;
}

/// Median of the seven steps about each: the local slope, which one jump or outlier does not move.
std::vector<double> local_slopes(const std::vector<double>& steps) {
  std::vector<double> slopes(steps.size());
  for (std::size_t i = 0; i < steps.size(); ++i) {
    const std::size_t begin = i < 3 ? 0 : i - 3, end = std::min(steps.size(), i + 4);
    std::array<double, 7> near{};
    const auto last = std::copy(steps.begin() + static_cast<std::ptrdiff_t>(begin),
                                steps.begin() + static_cast<std::ptrdiff_t>(end), near.begin());
    const auto middle = near.begin() + (last - near.begin()) / 2;
    std::nth_element(near.begin(), middle, last);
    slopes[i] = *middle;
  }
  return slopes;
}

bool is_jump(const Point& a, const Point& b, double slope) {
  const double rows = b.row - a.row;
  return rows > kLongestGapRows + 1 ||
         std::abs(b.x - a.x - slope * rows) > kJumpPx + kSlopeAllowance * std::abs(slope) * rows;
}

/// Leaves out single points off a line that goes on without them.
std::vector<Point> without_outliers(const std::vector<Point>& points) {
  if (points.size() < 3) return points;
  const std::vector<double> slopes = local_slopes(steps_of(points));
  std::vector<Point> kept;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const bool inner = i > 0 && i + 1 < points.size();
    const bool off_line = inner && is_jump(points[i - 1], points[i], slopes[i - 1]) &&
                          is_jump(points[i], points[i + 1], slopes[i]) &&
                          !is_jump(points[i - 1], points[i + 1], slopes[i]);
    if (!off_line) kept.push_back(points[i]);
  }
  return kept;
}

/// Value at the point itself of the quadratic through its neighbours in points[begin, end).
double local_quadratic(const std::vector<Point>& points, std::size_t at, std::size_t begin, std::size_t end) {
  const Point& center = points[at];
  double s0 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, t0 = 0, t1 = 0, t2 = 0;
  for (std::size_t i = begin; i < end; ++i) {
    const double k = points[i].row - center.row, value = points[i].x - center.x;
    const double weight = points[i].amplitude * std::exp(-0.5 * k * k / (kWindowRows * kWindowRows));
    s0 += weight;
    s1 += weight * k;
    s2 += weight * k * k;
    s3 += weight * k * k * k;
    s4 += weight * k * k * k * k;
    t0 += weight * value;
    t1 += weight * value * k;
    t2 += weight * value * k * k;
  }
  const double minor0 = s2 * s4 - s3 * s3, minor1 = s1 * s4 - s2 * s3, minor2 = s1 * s3 - s2 * s2;
  const double determinant = s0 * minor0 - s1 * minor1 + s2 * minor2;
  if (std::abs(determinant) <= 1e-9 * s0 * s2 * s4) return center.x;
  return center.x + (t0 * minor0 - t1 * minor1 + t2 * minor2) / determinant;
}

}  // namespace

void smooth_line(std::span<const LineRow> rows, std::span<float> smoothed_px) {
  if (rows.size() != smoothed_px.size()) {
    throw std::invalid_argument("smooth_line: " + std::to_string(rows.size()) + " rows, but room for " +
                                std::to_string(smoothed_px.size()));
  }
  std::fill(smoothed_px.begin(), smoothed_px.end(), -1.f);
  std::vector<Point> points;
  for (std::size_t y = 0; y < rows.size(); ++y) {
    if (rows[y].x_px >= 0) points.push_back({static_cast<int>(y), rows[y].x_px, std::max(rows[y].amplitude, 1e-3f)});
  }
  points = without_outliers(points);
  const std::vector<double> slopes = local_slopes(steps_of(points));
  for (std::size_t run_begin = 0; run_begin < points.size();) {
    std::size_t run_end = run_begin + 1;
    while (run_end < points.size() && !is_jump(points[run_end - 1], points[run_end], slopes[run_end - 1])) ++run_end;
    if (run_end - run_begin >= kFewestRows) {
      for (std::size_t i = run_begin; i < run_end; ++i) {
        std::size_t begin = i, end = i + 1;
        while (begin > run_begin && points[i].row - points[begin - 1].row <= kReachRows) --begin;
        while (end < run_end && points[end].row - points[i].row <= kReachRows) ++end;
        smoothed_px[static_cast<std::size_t>(points[i].row)] =
            static_cast<float>(local_quadratic(points, i, begin, end));
      }
    }
    run_begin = run_end;
  }
}

}  // namespace celadon
