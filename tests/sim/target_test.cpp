// Calibration targets: detectors that know nothing of the simulator find the corners where the truth says.
#include "sim/target.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "sim/board_body.h"
#include "sim/device_truth.h"
#include "sim/renderer.h"

namespace celadon::sim {
namespace {

constexpr int kCols = 1280, kLines = 1024;

struct Shot {
  std::vector<std::uint8_t> bytes;
  nlohmann::json truth;
};

/// A picture with the laser off under bright room light, with lens blur and noise.
Shot shoot(const std::string& name, int rim_tags, double angle) {
  Scene scene = *Scene::make(name);
  scene.set_rim_tags(rim_tags);
  DeviceConfig device;
  device.optics = default_optics(kCols, kLines, 0.3, 0.002);
  Renderer renderer(scene, device.optics);
  Exposure e;
  e.seed = 3;
  e.exposure_ns = 4'000'000;
  e.ambient_factor = 9;
  for (int i = 0; i < 10; ++i) e.motion.samples.push_back({angle, 0, 0});
  Shot shot;
  shot.bytes.resize(static_cast<std::size_t>(kCols * kLines));
  renderer.render(e, shot.bytes, kCols);
  shot.truth = corners_of(device, scene, {angle});
  return shot;
}

double nearest(const nlohmann::json& truth, double x, double y) {
  double least = 1e9;
  for (const auto& corner : truth) {
    least = std::min(least, std::hypot(corner["x_px"].get<double>() - x, corner["y_px"].get<double>() - y));
  }
  return least;
}

class ChessboardPoses : public ::testing::TestWithParam<const char*> {};

TEST_P(ChessboardPoses, OpenCvFindsTheCornersWhereTheTruthSays) {
  Shot shot = shoot(std::string("board:chessboard") + GetParam(), 0, 0);
  const cv::Mat image(kLines, kCols, CV_8U, shot.bytes.data());
  std::vector<cv::Point2f> found;
  ASSERT_TRUE(cv::findChessboardCornersSB(image, {10, 7}, found, cv::CALIB_CB_ACCURACY | cv::CALIB_CB_EXHAUSTIVE));
  ASSERT_EQ(found.size(), 70u);
  ASSERT_EQ(shot.truth.size(), 70u);
  double worst = 0, squares = 0;
  for (const cv::Point2f& p : found) {
    const double error = nearest(shot.truth, static_cast<double>(p.x), static_cast<double>(p.y));
    worst = std::max(worst, error);
    squares += error * error;
  }
  EXPECT_LT(std::sqrt(squares / 70), 0.05);
  EXPECT_LT(worst, 0.1);
}
INSTANTIATE_TEST_SUITE_P(Held, ChessboardPoses,
                         ::testing::Values("", "@10,5,60,8,-15,40", "@-10,0,55,-10,20,15", "@0,0,50,0,-40,30",
                                           "@5,-5,62,25,10,50"));

struct Detector {
  apriltag_family_t* family = tag36h11_create();
  apriltag_detector_t* detector = apriltag_detector_create();
  Detector() {
    apriltag_detector_add_family(detector, family);
    detector->quad_decimate = 1;
  }
  ~Detector() {
    apriltag_detector_destroy(detector);
    tag36h11_destroy(family);
  }
  Detector(const Detector&) = delete;
  Detector& operator=(const Detector&) = delete;
  /// Corners by (tag, corner); the library counts pixels from their edges.
  std::map<std::pair<int, int>, std::pair<double, double>> corners(std::vector<std::uint8_t>& bytes) const {
    image_u8_t image{kCols, kLines, kCols, bytes.data()};
    zarray_t* found = apriltag_detector_detect(detector, &image);
    std::map<std::pair<int, int>, std::pair<double, double>> out;
    for (int i = 0; i < zarray_size(found); ++i) {
      apriltag_detection_t* tag = nullptr;
      zarray_get(found, i, &tag);
      for (int k = 0; k < 4; ++k) out[{tag->id, k}] = {tag->p[k][0] - 0.5, tag->p[k][1] - 0.5};
    }
    apriltag_detections_destroy(found);
    return out;
  }
};

/// RMS of found less true; every found corner must be a true one.
double rms_of(const std::map<std::pair<int, int>, std::pair<double, double>>& found, const nlohmann::json& truth,
              double& worst) {
  double squares = 0;
  int count = 0;
  for (const auto& corner : truth) {
    const auto at = found.find({corner["id"].get<int>(), corner["corner"].get<int>()});
    if (at == found.end()) continue;
    const double error =
        std::hypot(at->second.first - corner["x_px"].get<double>(), at->second.second - corner["y_px"].get<double>());
    squares += error * error;
    worst = std::max(worst, error);
    ++count;
  }
  EXPECT_EQ(count, static_cast<int>(found.size()));
  return std::sqrt(squares / std::max(count, 1));
}

// libapriltag's tags lie in the middle of their white squares: the mean of a tag's corners between those of its square.
TEST(TagBoards, LibapriltagFindsTheTagsInTheirSquares) {
  for (const char* pose : {"", "@10,5,60,8,-15,40", "@held:-10,0,60,-10,20,15", "@5,-5,62,15,10,50"}) {
    Shot shot = shoot(std::string("board:tags:9x6x13+40") + pose, 0, 0);
    const auto found = Detector().corners(shot.bytes);
    EXPECT_EQ(found.size(), 4u * 27) << pose;
    std::map<int, Eigen::Vector2d> truth;
    for (const auto& corner : shot.truth) {
      truth[corner["corner"].get<int>()] = {corner["x_px"].get<double>(), corner["y_px"].get<double>()};
    }
    EXPECT_EQ(truth.size(), 8u * 5) << pose;
    int compared = 0;
    for (int row = 1; row < 5; ++row) {
      for (int column = 1; column < 8; ++column) {
        if ((row + column) % 2 == 0) continue;
        const int tag = 40 + (row * 9 + column - 1) / 2, corner = (row - 1) * 8 + column - 1;
        const auto at = [&](int k) {
          const auto place = found.find({tag, k});
          return place == found.end() ? Eigen::Vector2d(-1e6, 0)
                                      : Eigen::Vector2d(place->second.first, place->second.second);
        };
        // Lower left, lower right, upper right, upper left of the tag: three quarters of the way to its square's.
        const int square[] = {corner + 8, corner + 9, corner + 1, corner};
        for (int k = 0; k < 4; ++k) {
          const Eigen::Vector2d expected = 0.875 * truth[square[k]] + 0.125 * truth[square[(k + 2) % 4]];
          EXPECT_LT((at(k) - expected).norm(), 0.7) << pose << " tag " << tag << " corner " << k;
          ++compared;
        }
      }
    }
    EXPECT_EQ(compared, 4 * 14);
  }
}

TEST(RimTagsRound, ThePlattersEdgeShowTheTablesAngle) {
  for (const double angle : {0.0, 1.234}) {
    Shot shot = shoot("cylinder", 12, angle);
    const auto found = Detector().corners(shot.bytes);
    EXPECT_GE(found.size(), 4u * 3);
    double worst = 0;
    const double rms = rms_of(found, shot.truth, worst);
    EXPECT_LT(rms, 0.2);
  }
}

TEST(Boards, SayWhatIsWrong) {
  for (const auto& [name, word] : {std::pair{"board:circles", "chessboard"},
                                   {"board:tags@1,2,3", "X,Y,Z"},
                                   {"board:tags@0,0,58,0,0,x", "X,Y,Z"},
                                   {"board:tags@hold:0,0,58,0,0,0", "X,Y,Z"},
                                   {"board:tags@0,0,20,0,0,0", "raise"},
                                   {"board:tags@held:0,0,20,0,0,0", "raise"},
                                   {"board:tags:11x8", "can not be read"},
                                   {"board:tags:11x8x8+", "can not be read"},
                                   {"board:chessboard:11x8x8+4", "can not be read"},
                                   {"board:chessboard:11x9x8", "upside down"},
                                   {"board:tags:60x60x1", "586"},
                                   {"board:tags:2x8x8", "3 to 60"}}) {
    const auto scene = Scene::make(name);
    ASSERT_FALSE(scene) << name;
    EXPECT_NE(scene.error().find(word), std::string::npos) << scene.error();
  }
}

// Corners lie where cells of paper and ink meet.
TEST(Boards, CornersLieBetweenPaperAndInk) {
  const Target board = *Target::board("chessboard");
  ASSERT_EQ(board.corners().size(), 70u);
  for (const TargetCorner& corner : board.corners()) {
    const auto at = [&](double dx, double dy) { return board.reflectance(corner.p_mm.x() + dx, corner.p_mm.y() + dy); };
    EXPECT_EQ(at(1, 1), at(-1, -1));
    EXPECT_EQ(at(1, -1), at(-1, 1));
    EXPECT_NE(at(1, 1), at(1, -1));
  }
  const Target tag = Target::tag(7, 8);
  ASSERT_EQ(tag.corners().size(), 4u);
  for (const TargetCorner& corner : tag.corners()) {
    const double inwards_x = corner.corner == 0 || corner.corner == 3 ? 0.5 : -0.5;
    const double inwards_y = corner.corner >= 2 ? 0.5 : -0.5;
    EXPECT_EQ(tag.reflectance(corner.p_mm.x() + inwards_x, corner.p_mm.y() + inwards_y), kInk);
    EXPECT_EQ(tag.reflectance(corner.p_mm.x() - inwards_x, corner.p_mm.y() - inwards_y), kPaper);
  }
}

TEST(Boards, TagsFillThreeQuartersOfWhiteSquares) {
  const Target board = *Target::board("tags:5x4x16");
  EXPECT_EQ(board.width_mm(), 6 * 16);
  EXPECT_EQ(board.height_mm(), 5 * 16);
  ASSERT_EQ(board.corners().size(), 12u);
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 5; ++column) {
      const double x = (column - 2.5) * 16, y = (row - 2.0) * 16;  // of the square's upper left
      const bool white = (row + column) % 2 == 1;
      for (const auto& [dx, dy] : {std::pair{8.0, 1.0}, {8.0, 15.0}, {1.0, 8.0}, {15.0, 8.0}, {1.9, 1.9}}) {
        EXPECT_EQ(board.reflectance(x + dx, y + dy), white ? kPaper : kInk) << column << " " << row;
      }
      EXPECT_EQ(board.reflectance(x + 2.1, y + 8), kInk);  // a tag's border, or the black square
    }
  }
}

// Where a print of that pitch and bow lies, written out again.
TEST(Boards, HaveTheErrorsOfTheirPrint) {
  const PrintErrors errors{0.002, -0.001, 1.5};
  const Scene plain = *Scene::make("board:chessboard@held:0,0,60,0,0,0"),
              bad = *Scene::make("board:chessboard@held:0,0,60,0,0,0", errors);
  const double length = 12 * 8 * 1.002;  // of the paper
  double radius = 1e3;                   // of the bow: sagitta r (1 - cos(length / 2 r)), by halving
  for (double low = length / 2, high = 1e6; high - low > 1e-9; radius = 0.5 * (low + high)) {
    const double middle = 0.5 * (low + high);
    (middle * (1 - std::cos(length / (2 * middle))) > 1.5 ? low : high) = middle;
  }
  const auto meant = plain.corners(), got = bad.corners();
  ASSERT_EQ(meant.size(), 70u);
  for (std::size_t i = 0; i < meant.size(); ++i) {
    // The board faces the x axis: its x runs along y, its y downwards.
    const double x = 1.002 * meant[i].p.y(), y = 0.999 * (60 - meant[i].p.z());
    EXPECT_NEAR(got[i].p.y(), radius * std::sin(x / radius), 1e-6);
    EXPECT_NEAR(got[i].p.x(), radius * (std::cos(x / radius) - 1), 1e-6);
    EXPECT_NEAR(got[i].p.z(), 60 - y, 1e-9);
  }
  // Rays from the front meet the corners, and paper and ink in turn about them.
  for (const PrintErrors& print : {errors, PrintErrors{0, 0, -2}, PrintErrors{0, 0, 1e-9}, PrintErrors{0.01, 0, 0}}) {
    const Scene scene = *Scene::make("board:chessboard@held:3,4,60,10,-20,30", print);
    const Eigen::Vector3d eye(300, 150, 110);
    for (const PrintedCorner& corner : scene.corners()) {
      const auto hit = scene.intersect({eye, corner.p - eye});
      ASSERT_TRUE(hit);
      EXPECT_NEAR(hit->t, 1, 1e-9);
      EXPECT_GT(hit->normal.dot(eye - corner.p), 0);
    }
  }
}

TEST(Boards, HeldInAHandDoNotTurnWithTheTable) {
  const std::string pose = "5,5,60,8,-15,40";
  const Shot held = shoot("board:chessboard@held:" + pose, 0, 1.1), still = shoot("board:chessboard@" + pose, 0, 0),
             turned = shoot("board:chessboard@" + pose, 0, 0.1);
  EXPECT_EQ(held.bytes, still.bytes);
  EXPECT_EQ(held.truth, still.truth);
  EXPECT_NE(turned.truth, still.truth);
}

}  // namespace
}  // namespace celadon::sim
