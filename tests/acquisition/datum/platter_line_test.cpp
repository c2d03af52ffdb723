// A laser's line on the platter against the closed form of a plane that meets another.
#include "acquisition/datum/platter_line.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "acquisition/triangulation.h"
#include "tests/acquisition/datum/rim_camera.h"

namespace celadon {
namespace {

using testing::RimCamera;

constexpr int kFrames = 40;

/// In the exposure of a scan, which is short for a dark platter.
std::vector<PlatterHeight> seen_of(RimCamera& camera, const Calibration& calibration, int laser, double beyond_mm) {
  PlatterLine line(calibration, laser, line_along(calibration.lasers.front()));
  const std::vector<std::uint8_t> dark = camera.mean_dark(8);
  for (int k = 0; k < kFrames; ++k) {
    line.add(camera.mode(), camera.shoot(0.15 * k, static_cast<std::uint64_t>(100 + k), true), dark);
  }
  return line.heights(beyond_mm);
}

TEST(PlatterLine, LiesOnThePlatter) {
  RimCamera camera("empty", 1, 0);
  const auto heights = seen_of(camera, camera.truth(), 0, 5);
  ASSERT_GE(heights.size(), 16U);
  double sum = 0, squares = 0;
  for (const PlatterHeight& h : heights) sum += h.z_mm, squares += h.z_mm * h.z_mm;
  const double n = static_cast<double>(heights.size());
  std::printf("%zu places from %.1f to %.1f mm, mean %.4f, rms %.4f mm\n", heights.size(), heights.front().r_mm,
              heights.back().r_mm, sum / n, std::sqrt(squares / n));
  EXPECT_LE(std::abs(sum / n), 0.02);
  EXPECT_LE(std::sqrt(squares / n), 0.15);
  for (const PlatterHeight& h : heights) EXPECT_GT(h.r_mm, 5);
}

// The plane that the calibration has is moved by d along its normal: the line then seems to lie where the pixels' rays
// meet that plane.
TEST(PlatterLine, TellsHowFarALaserMoved) {
  RimCamera camera("empty", 1, 0);
  const Calibration truth = camera.truth();
  Calibration moved = truth;
  moved.lasers[0].distance_mm += 0.5;
  const auto was = seen_of(camera, truth, 0, 5), is = seen_of(camera, moved, 0, 5);
  ASSERT_GE(is.size(), 16U);
  const Eigen::Vector3d n = truth.axis.X_CW.linear().transpose() * truth.lasers[0].normal_C;
  const Eigen::Vector3d camera_W = truth.axis.X_CW.inverse().translation();
  double sum = 0;
  for (const PlatterHeight& h : is) sum += h.z_mm;
  double zero = 0;
  for (const PlatterHeight& h : was) zero += h.z_mm;
  const double mean = sum / static_cast<double>(is.size()) - zero / static_cast<double>(was.size());
  // Along a ray from the camera C to p on the platter, a shift s of the length changes n . p by s n . ray and z by s
  // ray_z.
  const Eigen::Vector3d ray = -camera_W.normalized();
  const double expected = 0.5 * ray.z() / n.dot(ray);
  std::printf("moved by 0.5 mm: height %.3f mm, at the axis %.3f\n", mean, expected);
  EXPECT_NEAR(mean, expected, 0.2 * std::abs(expected));
}

TEST(PlatterLine, WithoutTheLaserThereIsNone) {
  RimCamera camera("empty", 1, 0);
  const Calibration truth = camera.truth();
  PlatterLine line(truth, 0, line_along(truth.lasers.front()));
  EXPECT_TRUE(line.heights(0).empty());
  const std::vector<std::uint8_t> dark = camera.mean_dark(8);
  for (int k = 0; k < kFrames; ++k)
    line.add(camera.mode(), camera.shoot(0.15 * k, static_cast<std::uint64_t>(100 + k)), dark);
  EXPECT_LE(line.heights(0).size(), 2u);
  EXPECT_THROW(PlatterLine(truth, 3, LineAlong::rows), std::invalid_argument);
}

// Of one frame nothing is seen: the mean is what shows it.
TEST(PlatterLine, IsBelowTheNoiseOfOneFrame) {
  RimCamera camera("empty", 1, 0);
  const Calibration truth = camera.truth();
  const LineAlong along = line_along(truth.lasers.front());
  LaserLineExtractor extractor({.along = along});
  std::vector<LineRow> rows(RimCamera::kHeight);
  extractor.extract(camera.mode(), camera.shoot(0, 99, true), camera.mean_dark(8), rows);
  EXPECT_LT(std::count_if(rows.begin(), rows.end(), [](const LineRow& r) { return r.status == RowStatus::found; }), 20);
}

// A picture in YUYV and one on its side say the same.
TEST(PlatterLine, InOtherPicturesIsTheSame) {
  RimCamera camera("empty", 1, 0);
  const Calibration truth = camera.truth();
  PlatterLine grey(truth, 0, LineAlong::rows), yuyv(truth, 0, LineAlong::rows);
  CameraMode mode = camera.mode();
  mode.format = PixelFormat::yuyv;
  mode.stride_bytes = std::size_t{2} * RimCamera::kWidth;
  const auto in_yuyv = [&](const std::vector<std::uint8_t>& luma) {
    std::vector<std::uint8_t> bytes;
    for (const std::uint8_t y : luma) bytes.insert(bytes.end(), {y, 128});
    return bytes;
  };
  const std::vector<std::uint8_t> dark = camera.mean_dark(8);
  for (int k = 0; k < 10; ++k) {
    const std::vector<std::uint8_t> lit = camera.shoot(0, static_cast<std::uint64_t>(100 + k), true);
    grey.add(camera.mode(), lit, dark);
    yuyv.add(mode, in_yuyv(lit), in_yuyv(dark));
  }
  const auto a = grey.heights(5), b = yuyv.heights(5);
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t k = 0; k < a.size(); ++k) EXPECT_EQ(a[k].z_mm, b[k].z_mm);
}

}  // namespace
}  // namespace celadon
