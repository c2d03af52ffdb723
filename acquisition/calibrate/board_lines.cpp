#include "acquisition/calibrate/board_lines.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>

#include "acquisition/calibrate/board_homography.h"

namespace celadon {
namespace {

using Eigen::Vector2d;

constexpr double kReach = 3;     // of the line's width, within which the board has to be plain
constexpr double kPlain = 0.15;  // largest relative difference of brightness there
constexpr int kPlainLevels = 6;  // and the difference that noise makes
constexpr double kMargin = 0.1;  // of a square, to the rim of the print
constexpr int kFewestPoints = 40;
constexpr int kDraws = 400;
constexpr double kOnLine_px = 1.5;  // a lens bends a line by less than this over a platter

bool has_line(const LineRow& row) {
  return row.status == RowStatus::found && row.sigma_px > 0;
}

bool plain_about(const GreyView& dark, int y, double x, double width_px) {
  const int first = static_cast<int>(std::floor(x - kReach * width_px));
  const int last = static_cast<int>(std::ceil(x + kReach * width_px));
  if (first < 0 || last >= dark.width_px) return false;
  const auto row = dark.bytes.subspan(static_cast<std::size_t>(y) * static_cast<std::size_t>(dark.width_px),
                                      static_cast<std::size_t>(dark.width_px));
  const auto [low, high] = std::minmax_element(row.begin() + first, row.begin() + last + 1);
  return *high - *low <= kPlainLevels + kPlain * *high;
}

/// Mean inclination dx/dy of a line, from pairs of points some rows apart.
double inclination(std::span<const SeenLinePoint> points) {
  std::vector<double> slopes;
  const std::size_t apart = std::max<std::size_t>(points.size() / 3, 1);
  for (std::size_t i = 0; i + apart < points.size(); ++i) {
    const Vector2d d = points[i + apart].p_px - points[i].p_px;
    if (d.y() != 0) slopes.push_back(d.x() / d.y());
  }
  if (slopes.empty()) return 0;
  const auto middle = slopes.begin() + static_cast<std::ptrdiff_t>(slopes.size() / 2);
  std::nth_element(slopes.begin(), middle, slopes.end());
  return *middle;
}

/// From uncertainties along the rows to those across the line.
void turn_across(std::vector<SeenLinePoint>& points) {
  const double across = 1 / std::hypot(1, inclination(points));
  for (SeenLinePoint& p : points) p.sigma_px *= across;
}

/// The points of the straight line that has the most of them.
std::vector<SeenLinePoint> straight_part(const std::vector<SeenLinePoint>& all) {
  if (all.size() < kFewestPoints) return {};
  std::mt19937 random(1);
  std::uniform_int_distribution<std::size_t> any(0, all.size() - 1);
  std::vector<SeenLinePoint> best;
  for (int draw = 0; draw < kDraws; ++draw) {
    const Vector2d a = all[any(random)].p_px, d = all[any(random)].p_px - a;
    if (d.norm() < 20) continue;
    const Vector2d across = Vector2d(-d.y(), d.x()).normalized();
    std::vector<SeenLinePoint> on;
    for (const SeenLinePoint& p : all) {
      if (std::abs(across.dot(p.p_px - a)) < kOnLine_px) on.push_back(p);
    }
    if (on.size() > best.size()) best = std::move(on);
  }
  if (best.size() < kFewestPoints) best.clear();
  return best;
}

}  // namespace

std::vector<SeenLinePoint> line_points_on_board(const TargetBoard& board, std::span<const SeenCorner> corners,
                                                const GreyView& dark, std::span<const LineRow> rows) {
  std::vector<SeenLinePoint> points;
  const auto to_picture = board_homography(board, corners);
  if (!to_picture) return points;
  const Eigen::Matrix3d to_board = to_picture->inverse();
  const double half_x = (0.5 * board.columns() - kMargin) * board.square_mm();
  const double half_y = (0.5 * board.rows() - kMargin) * board.square_mm();
  for (int y = 0; y < static_cast<int>(rows.size()); ++y) {
    const LineRow& row = rows[static_cast<std::size_t>(y)];
    if (!has_line(row)) continue;
    const double x = static_cast<double>(row.x_px);
    const Vector2d p = (to_board * Eigen::Vector3d(x, y, 1)).hnormalized();
    if (std::abs(p.x()) > half_x || std::abs(p.y()) > half_y) continue;
    if (!plain_about(dark, y, x, static_cast<double>(row.width_px))) continue;
    points.push_back({Vector2d(x, y), static_cast<double>(row.sigma_px)});
  }
  turn_across(points);
  return points;
}

std::vector<SeenLinePoint> straight_line(std::span<const LineRow> rows, std::span<const LineRow> columns) {
  std::vector<SeenLinePoint> upright, lying;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (!has_line(rows[i])) continue;
    upright.push_back(
        {Vector2d(static_cast<double>(rows[i].x_px), static_cast<double>(i)), static_cast<double>(rows[i].sigma_px)});
  }
  for (std::size_t i = 0; i < columns.size(); ++i) {
    if (!has_line(columns[i])) continue;
    lying.push_back({Vector2d(static_cast<double>(columns[i].x_px), static_cast<double>(i)),
                     static_cast<double>(columns[i].sigma_px)});
  }
  std::vector<SeenLinePoint> by_rows = straight_part(upright), by_columns = straight_part(lying);
  turn_across(by_rows);
  turn_across(by_columns);
  for (SeenLinePoint& p : by_columns) std::swap(p.p_px.x(), p.p_px.y());
  return by_rows.size() >= by_columns.size() ? by_rows : by_columns;
}

}  // namespace celadon
