// Calibration targets: detectors that know nothing of the simulator find the corners where the truth says.
#include "sim/target.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
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
  shot.truth = corners_of(device, scene, angle);
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

class TagPoses : public ::testing::TestWithParam<const char*> {};

TEST_P(TagPoses, LibapriltagFindsTheCornersWhereTheTruthSays) {
  Shot shot = shoot(std::string("board:tags") + GetParam(), 0, 0);
  const auto found = Detector().corners(shot.bytes);
  EXPECT_EQ(found.size(), 80u);
  double worst = 0;
  const double rms = rms_of(found, shot.truth, worst);
  EXPECT_LT(rms, 0.16);
  EXPECT_LT(worst, 0.35);
}
INSTANTIATE_TEST_SUITE_P(Held, TagPoses,
                         ::testing::Values("", "@10,5,60,8,-15,40", "@-10,0,55,-10,20,15", "@5,-5,62,15,10,50"));

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
                                   {"board:tags@0,0,20,0,0,0", "raise"}}) {
    const auto scene = Scene::make(name);
    ASSERT_FALSE(scene) << name;
    EXPECT_NE(scene.error().find(word), std::string::npos) << scene.error();
  }
}

// Corners lie where cells of paper and ink meet.
TEST(Boards, CornersLieBetweenPaperAndInk) {
  const Target board = Target::chessboard();
  ASSERT_EQ(board.corners().size(), 70u);
  for (const TargetCorner& corner : board.corners()) {
    const auto at = [&](double dx, double dy) { return board.reflectance(corner.p_mm.x() + dx, corner.p_mm.y() + dy); };
    EXPECT_EQ(at(1, 1), at(-1, -1));
    EXPECT_EQ(at(1, -1), at(-1, 1));
    EXPECT_NE(at(1, 1), at(1, -1));
  }
  const Target tags = Target::tag_grid();
  ASSERT_EQ(tags.corners().size(), 80u);
  for (const TargetCorner& corner : tags.corners()) {
    const double inwards_x = corner.corner == 0 || corner.corner == 3 ? 0.5 : -0.5;
    const double inwards_y = corner.corner >= 2 ? 0.5 : -0.5;
    EXPECT_EQ(tags.reflectance(corner.p_mm.x() + inwards_x, corner.p_mm.y() + inwards_y), kInk);
    EXPECT_EQ(tags.reflectance(corner.p_mm.x() - inwards_x, corner.p_mm.y() - inwards_y), kPaper);
  }
}

}  // namespace
}  // namespace celadon::sim
