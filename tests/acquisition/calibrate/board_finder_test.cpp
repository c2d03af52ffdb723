// Corners of boards against the truth of the virtual scanner, which prints, projects and tells them by code of its own.
#include "acquisition/calibrate/board_finder.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <opencv2/imgproc.hpp>

#include "tests/acquisition/calibrate/board_camera.h"

namespace celadon {
namespace {

using Eigen::Vector2d;
using testing::BoardCamera;
using testing::CornerErrors;

BoardFinder finder_of(const std::string& board) {
  return BoardFinder(*TargetBoard::parse(board));
}

tl::expected<std::vector<SeenCorner>, std::string> find(BoardFinder& finder, const std::vector<std::uint8_t>& bytes) {
  return finder.find(bytes, BoardCamera::kWidth, BoardCamera::kHeight);
}

constexpr const char *kChessboard = "chessboard:11x8x8", *kTags = "tags:10x7x12";

// Facing, turned about each axis, tilted by 40 and 55 degrees, at the picture's edges, near and far.
constexpr const char* kPoses[] = {"",
                                  "@10,5,60,8,-15,40",
                                  "@-10,0,60,-10,20,15",
                                  "@0,0,55,0,-40,30",
                                  "@held:5,-5,74,25,10,60",
                                  "@held:-20,-10,65,3,5,80",
                                  "@held:20,25,75,-5,-10,30",
                                  "@held:-60,-40,64,170,10,20"};

class BoardPoses : public ::testing::TestWithParam<std::tuple<const char*, const char*>> {};

TEST_P(BoardPoses, CornersLieWhereTheTruthSays) {
  const auto [board, pose] = GetParam();
  BoardCamera camera("board:" + std::string(board) + pose);
  BoardFinder finder = finder_of(board);
  const std::vector<std::uint8_t> bytes = camera.shoot(3);
  const auto found = find(finder, bytes);
  ASSERT_TRUE(found) << found.error();
  EXPECT_GE(found->size(), camera.truth().size() * 4 / 5);
  const CornerErrors errors(*found, camera.truth());

  // The same places by OpenCV's refinement, for comparison.
  cv::Mat image(BoardCamera::kHeight, BoardCamera::kWidth, CV_8U, const_cast<std::uint8_t*>(bytes.data()));
  std::vector<cv::Point2f> refined;
  for (const SeenCorner& corner : *found) refined.emplace_back(corner.p_px.x(), corner.p_px.y());
  cv::cornerSubPix(image, refined, {5, 5}, {-1, -1}, {cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 40, 1e-4});
  std::vector<SeenCorner> by_opencv = *found;
  double sigmas = 0;
  for (std::size_t i = 0; i < refined.size(); ++i) {
    by_opencv[i].p_px = Vector2d(static_cast<double>(refined[i].x), static_cast<double>(refined[i].y));
    sigmas += (*found)[i].sigma_px * (*found)[i].sigma_px;
  }
  const CornerErrors opencv(by_opencv, camera.truth());
  std::printf(
      "%-18s %-28s %3d corners: rms %.4f, stated %.4f, mean (%+.4f, %+.4f), worst %.3f px; cornerSubPix rms "
      "%.4f px\n",
      board, pose, errors.count, errors.rms_px, std::sqrt(sigmas / std::max(1, errors.count)), errors.mean_px.x(),
      errors.mean_px.y(), errors.worst_px, opencv.rms_px);
  EXPECT_LE(errors.rms_px, 0.03);
  EXPECT_LE(std::abs(errors.mean_px.x()), 0.01);
  EXPECT_LE(std::abs(errors.mean_px.y()), 0.01);
  EXPECT_LE(errors.worst_px, 0.12);
  EXPECT_LE(errors.rms_px, 1.1 * opencv.rms_px);
}
INSTANTIATE_TEST_SUITE_P(Held, BoardPoses,
                         ::testing::Combine(::testing::Values(kChessboard, kTags), ::testing::ValuesIn(kPoses)));

// Far enough that a board turned by 90 degrees fits above the platter and into the picture.
TEST(BoardFinder, KnowsItsCornersInEveryDirection) {
  for (const char* board : {kChessboard, kTags, "tags:9x6x10+100", "tags:7x7x12", "chessboard:6x9x9"}) {
    BoardFinder finder = finder_of(board);
    for (int turn = 0; turn < 360; turn += board == std::string(kTags) ? 45 : 90) {
      const char* place = board == std::string(kTags) ? "@held:-40,-23,84," : "@held:-40,-23,74,";
      BoardCamera camera("board:" + std::string(board) + place + std::to_string(turn) + ",5,35");
      const auto found = find(finder, camera.shoot(1));
      ASSERT_TRUE(found) << board << " turned by " << turn << ": " << found.error();
      EXPECT_GE(found->size(), camera.truth().size() * 3 / 4) << board << " turned by " << turn;
      EXPECT_LE(CornerErrors(*found, camera.truth()).worst_px, 0.2) << board << " turned by " << turn;
    }
  }
}

TEST(BoardFinder, FindsWhatIsSeenOfATagBoard) {
  BoardCamera camera(std::string("board:") + kTags + "@held:10,5,60,8,-15,40");
  BoardFinder finder = finder_of(kTags);
  const auto whole = find(finder, camera.shoot(2));
  ASSERT_TRUE(whole) << whole.error();
  // A dark hand over its left part, with an oblique edge.
  const auto hidden = [&](double share, double slope) {
    std::vector<std::uint8_t> bytes = camera.shoot(2);
    for (int y = 0; y < BoardCamera::kHeight; ++y) {
      const int edge = static_cast<int>(170 + share * 950 + slope * (y - 512));
      for (int x = 0; x < std::clamp(edge, 0, BoardCamera::kWidth); ++x) {
        bytes[static_cast<std::size_t>(y * BoardCamera::kWidth + x)] = static_cast<std::uint8_t>(70 + (x * 7 + y) % 9);
      }
    }
    return bytes;
  };
  for (const double share : {0.3, 0.5, 0.65}) {
    for (const double slope : {-0.6, 0.0, 0.4}) {
      const auto found = find(finder, hidden(share, slope));
      ASSERT_TRUE(found) << share << " " << slope << ": " << found.error();
      EXPECT_LT(found->size(), whole->size());
      EXPECT_GE(found->size(), 8u);
      EXPECT_LE(CornerErrors(*found, camera.truth()).worst_px, 0.12) << share << " " << slope;
    }
  }
  const auto little = find(finder, hidden(0.82, 0));
  ASSERT_FALSE(little) << little->size();
  EXPECT_NE(little.error().find("only "), std::string::npos) << little.error();
}

// Standard deviations as stated against the scatter over pictures that differ by their noise alone.
TEST(BoardFinder, StatesTheScatterOfItsCorners) {
  for (const auto& [board, light, noise] :
       {std::tuple{kChessboard, 9.0, 1.0}, {kTags, 9.0, 1.0}, {kTags, 3.0, 2.0}, {kChessboard, 5.0, 3.0}}) {
    BoardCamera camera("board:" + std::string(board) + "@held:5,0,60,8,-25,45", light, 0.6, noise);
    BoardFinder finder = finder_of(board);
    struct Sums {
      int count = 0;
      Vector2d p = Vector2d::Zero(), p2 = Vector2d::Zero();
      double variance = 0;
    };
    std::map<int, Sums> sums;
    constexpr int kPictures = 10;
    for (int seed = 0; seed < kPictures; ++seed) {
      const auto found = find(finder, camera.shoot(static_cast<std::uint64_t>(100 + seed)));
      ASSERT_TRUE(found) << found.error();
      for (const SeenCorner& corner : *found) {
        Sums& s = sums[corner.id];
        const Vector2d d = corner.p_px - camera.truth().at(corner.id);
        ++s.count;
        s.p += d;
        s.p2 += d.cwiseAbs2();
        s.variance += corner.sigma_px * corner.sigma_px;
      }
    }
    double scatter = 0, stated = 0;
    int corners = 0;
    for (const auto& [id, s] : sums) {
      if (s.count < kPictures) continue;
      scatter += (s.p2 - s.p.cwiseAbs2() / s.count).sum() / (2 * (s.count - 1));
      stated += s.variance / s.count;
      ++corners;
    }
    EXPECT_GE(corners, 40);
    std::printf("%-18s light %.0f, noise x %.0f: scatter %.4f px, stated %.4f px\n", board, light, noise,
                std::sqrt(scatter / corners), std::sqrt(stated / corners));
    EXPECT_NEAR(std::sqrt(stated / scatter), 1, 0.3) << board;
  }
}

}  // namespace
}  // namespace celadon
