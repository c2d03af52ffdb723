// Points of a line on a board whose picture is a plane map written down here.
#include "acquisition/calibrate/board_lines.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>
#include <span>
#include <vector>

#include "acquisition/calibrate/board_homography.h"

namespace celadon {
namespace {

constexpr int kWidth = 640, kHeight = 480;

const TargetBoard& board() {
  static const TargetBoard b(8, 5, 10, false);
  return b;
}

/// Board to picture: 5 px/mm, turned and seen a little from the side.
const Eigen::Matrix3d& to_picture() {
  static const Eigen::Matrix3d H = (Eigen::Matrix3d() << 5.1, 0.4, 320, -0.3, 4.9, 240, 4e-4, -3e-4, 1).finished();
  return H;
}

std::vector<SeenCorner> corners() {
  std::vector<SeenCorner> out;
  for (const BoardCorner& c : board().corners()) {
    out.push_back({c.id, (to_picture() * c.p_mm.homogeneous()).hnormalized(), 0.02});
  }
  return out;
}

/// Where a pixel is on the print, in squares from its upper left corner.
Eigen::Vector2d squares_at(double x, double y) {
  const Eigen::Vector2d p = (to_picture().inverse() * Eigen::Vector3d(x, y, 1)).hnormalized();
  return {p.x() / board().square_mm() + 4, p.y() / board().square_mm() + 2.5};
}

std::vector<std::uint8_t> picture() {
  std::vector<std::uint8_t> grey;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Eigen::Vector2d s = squares_at(x, y);
      const bool inside = s.x() > 0 && s.x() < 8 && s.y() > 0 && s.y() < 5;
      const bool black = (static_cast<int>(std::floor(s.x())) + static_cast<int>(std::floor(s.y()))) % 2 == 0;
      grey.push_back(!inside ? 90 : black ? 12 : 180);
    }
  }
  return grey;
}

LineRow found(double x) {
  LineRow row;
  row.x_px = static_cast<float>(x);
  row.sigma_px = 0.1f;
  row.width_px = 2;
  row.status = RowStatus::found;
  return row;
}

TEST(BoardHomography, IsTheMapThatMadeThePicture) {
  const std::vector<SeenCorner> all = corners();
  const auto H = board_homography(board(), all);
  ASSERT_TRUE(H);
  for (const BoardCorner& c : board().corners()) {
    const Eigen::Vector2d wanted = (to_picture() * c.p_mm.homogeneous()).hnormalized();
    const Eigen::Vector2d mapped = (*H * c.p_mm.homogeneous()).hnormalized();
    EXPECT_LT((mapped - wanted).norm(), 1e-4) << "OpenCV takes the points as floats";
  }
  EXPECT_FALSE(board_homography(board(), std::span<const SeenCorner>(all).first(3)));
}

TEST(BoardLines, CountWhereThePrintBesideThemIsPlain) {
  const auto grey = picture();
  constexpr double kSlope = 0.35;
  std::vector<LineRow> rows;
  for (int y = 0; y < kHeight; ++y) rows.push_back(found(250 + kSlope * y));
  rows[200].status = RowStatus::saturated;
  const auto points = line_points_on_board(board(), corners(), {grey, kWidth, kHeight}, rows);
  EXPECT_GT(points.size(), 100u);
  std::size_t plain = 0;
  for (int y = 0; y < kHeight; ++y) {
    // Distance along the row to the next edge of a square, and to the rim of the print.
    const double x = 250 + kSlope * y;
    bool same = true, inside = true;
    for (int k = -6; k <= 6; ++k) {
      const Eigen::Vector2d here = squares_at(x, y), there = squares_at(x + k, y);
      same = same && std::floor(here.x()) == std::floor(there.x()) && std::floor(here.y()) == std::floor(there.y());
      inside = inside && here.x() > 0.1 && here.x() < 7.9 && here.y() > 0.1 && here.y() < 4.9;
    }
    plain += same && inside && y != 200 ? 1 : 0;
  }
  EXPECT_NEAR(static_cast<double>(points.size()), static_cast<double>(plain), 0.06 * static_cast<double>(plain));
  for (const SeenLinePoint& p : points) {
    EXPECT_NEAR(p.p_px.x(), 250 + kSlope * p.p_px.y(), 1e-4);
    EXPECT_NE(p.p_px.y(), 200);
    EXPECT_NEAR(p.sigma_px, 0.1 / std::hypot(1, kSlope), 1e-6) << "across the line, not along the row";
    int low = 255, high = 0;
    for (int k = -5; k <= 5; ++k) {
      const int level = grey[static_cast<std::size_t>(p.p_px.y()) * kWidth + static_cast<std::size_t>(p.p_px.x() + k)];
      low = std::min(low, level);
      high = std::max(high, level);
    }
    EXPECT_EQ(low, high) << p.p_px.transpose();
  }
}

TEST(BoardLines, TheStraightLineOfAPlatterIsFoundAmongStrays) {
  std::mt19937 random(3);
  const auto anywhere = [&](double end) { return std::uniform_real_distribution<double>(0, end)(random); };
  for (const bool lying : {false, true}) {
    // Steep in one picture; in the one turned over its diagonal it hardly shows.
    std::vector<LineRow> rows(kHeight), columns(kWidth);
    auto& good = lying ? columns : rows;
    auto& other = lying ? rows : columns;
    for (std::size_t i = 0; i < good.size(); ++i)
      good[i] = found(i % 4 == 0 ? anywhere(400) : 100 + 0.3 * static_cast<double>(i));
    for (std::size_t i = 0; i < other.size(); i += 9) other[i] = found(anywhere(400));
    const auto line = straight_line(rows, columns);
    EXPECT_GE(line.size(), good.size() * 3 / 4);
    for (const SeenLinePoint& p : line) {
      const double along = lying ? p.p_px.x() : p.p_px.y(), across = lying ? p.p_px.y() : p.p_px.x();
      EXPECT_NEAR(across, 100 + 0.3 * along, 3.2);
      EXPECT_NEAR(p.sigma_px, 0.1 / std::hypot(1, 0.3), 2e-3);
    }
  }
  std::vector<LineRow> rows(kHeight), columns(kWidth);
  for (std::size_t i = 0; i < 30; ++i) rows[i] = found(100);
  EXPECT_TRUE(straight_line(rows, columns).empty());
}

}  // namespace
}  // namespace celadon
