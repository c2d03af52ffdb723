// Colours beside a line, against pictures whose colours are known, and the conversion against that of other libraries.
#include "acquisition/surface_colour.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <turbojpeg.h>

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <random>

#include "tests/acquisition/colour_picture.h"
#include "tests/acquisition/test_calibration.h"

namespace celadon {
namespace {

using testing::ColourPicture;
using testing::picture_of;
using testing::Rgb;
using testing::to_level;
using testing::yuv_of;

constexpr int kWidth = 1280, kHeight = 1024;
constexpr ColourLayout kLayouts[] = {ColourLayout::yuyv, ColourLayout::uv_pairs, ColourLayout::uv_cells,
                                     ColourLayout::bggr, ColourLayout::gbrg,     ColourLayout::grbg,
                                     ColourLayout::rggb};

std::vector<std::uint8_t> random_levels(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::uint8_t> out(count);
  for (std::uint8_t& level : out) level = static_cast<std::uint8_t>(random());
  return out;
}

double clamped(float value) {
  return std::clamp(static_cast<double>(value), 0., 255.);
}

TEST(ColourOf, LimitedRangeIsThatOfOpenCv) {
  constexpr int kPairs = 4000;
  auto yuyv = random_levels(4 * kPairs, 1);
  for (std::size_t i = 0; i < yuyv.size(); ++i) {
    const int most = i % 2 == 0 ? 235 : 240;  // what the range allows
    yuyv[i] = static_cast<std::uint8_t>(16 + yuyv[i] % (most - 15));
  }
  const cv::Mat in(1, 2 * kPairs, CV_8UC2, yuyv.data());
  cv::Mat rgb;
  cv::cvtColor(in, rgb, cv::COLOR_YUV2RGB_YUYV);
  const ColourCoding coding{ColourLayout::yuyv, 0, LumaWeights::bt601, true};
  for (std::size_t x = 0; x < 2 * kPairs; ++x) {
    const std::size_t pair = 4 * (x / 2);
    const LinearColour c = colour_of(coding, yuyv[2 * x], yuyv[pair + 1], yuyv[pair + 3]);
    const auto truth = rgb.at<cv::Vec3b>(0, static_cast<int>(x));
    ASSERT_NEAR(clamped(c.red), truth[0], 1);
    ASSERT_NEAR(clamped(c.green), truth[1], 1);
    ASSERT_NEAR(clamped(c.blue), truth[2], 1);
  }
}

TEST(ColourOf, FullRangeIsThatOfJpegs) {
  constexpr int kPixels = 4096;
  const auto y = random_levels(kPixels, 2), u = random_levels(kPixels, 3), v = random_levels(kPixels, 4);
  const unsigned char* planes[] = {y.data(), u.data(), v.data()};
  std::vector<std::uint8_t> rgb(3 * kPixels);
  const tjhandle jpeg = tjInitDecompress();
  ASSERT_EQ(tjDecodeYUVPlanes(jpeg, planes, nullptr, TJSAMP_444, rgb.data(), 64, 0, 64, TJPF_RGB, 0), 0);
  tjDestroy(jpeg);
  for (std::size_t i = 0; i < kPixels; ++i) {
    const LinearColour c = colour_of({}, y[i], u[i], v[i]);
    ASSERT_NEAR(clamped(c.red), rgb[3 * i], 1);
    ASSERT_NEAR(clamped(c.green), rgb[3 * i + 1], 1);
    ASSERT_NEAR(clamped(c.blue), rgb[3 * i + 2], 1);
  }
}

TEST(ColourOf, UndoesTheDefinitionInEveryCoding) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> level(0, 255);
  for (const LumaWeights weights : {LumaWeights::bt601, LumaWeights::bt709}) {
    for (const bool limited : {false, true}) {
      for (int i = 0; i < 1000; ++i) {
        const Rgb truth{level(random), level(random), level(random)};
        const auto yuv = yuv_of(truth, weights, limited);
        const LinearColour c = colour_of({ColourLayout::yuyv, 0, weights, limited}, static_cast<float>(yuv[0]),
                                         static_cast<float>(yuv[1]), static_cast<float>(yuv[2]));
        ASSERT_NEAR(c.red, truth[0], 1e-3);
        ASSERT_NEAR(c.green, truth[1], 1e-3);
        ASSERT_NEAR(c.blue, truth[2], 1e-3);
      }
    }
  }
}

LineRow row_at(double x_px, double width_px) {
  return {.x_px = static_cast<float>(x_px),
          .sigma_px = 0.2F,
          .amplitude = 150,
          .width_px = static_cast<float>(width_px),
          .status = RowStatus::found};
}

/// A profile as a triangulator makes it of all rows that have a line, each sample so far from the axis.
Profile profile_of(std::span<const LineRow> rows, double r_mm) {
  Profile out;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (rows[i].status != RowStatus::found && rows[i].status != RowStatus::saturated) continue;
    out.r_mm.push_back(r_mm);
    out.theta_rad.push_back(0);
    out.z_mm.push_back(0);
    out.row.push_back(static_cast<std::uint16_t>(i));
  }
  return out;
}

constexpr double kFarOut_mm = 1e4;  // every ray comes that near to the axis
const ScanVolume kWhole{.r_min_mm = 1e-6, .r_max_mm = 1e5, .z_min_mm = -1e5, .z_max_mm = 1e5};

std::vector<SampleColour> colours_of(const ColourPicture& picture, std::span<const LineRow> rows,
                                     LineAlong along = LineAlong::rows, double r_mm = kFarOut_mm) {
  testing::NobodyReturns owner;
  const Frame frame = picture.frame(owner);
  SurfaceColour colour(picture.mode, along);
  colour.read(frame, rows);
  Profile profile = profile_of(rows, r_mm);
  colour.give(Triangulator(test_calibration(), 0, kWhole, along), profile);
  return profile.colour;
}

void expect_near(const SampleColour& found, const Rgb& truth, double levels, const std::string& what) {
  EXPECT_NEAR(found.red, truth[0], levels) << what;
  EXPECT_NEAR(found.green, truth[1], levels) << what;
  EXPECT_NEAR(found.blue, truth[2], levels) << what;
}

// Each row its own colour on the left and on the right, a bright line of any width and place between: the mean of both
// sides comes back, and nothing of the line.
RC_GTEST_PROP(SurfaceColour, IsTheMeanOfBothSidesWithoutTheLine, ()) {
  const auto layout = kLayouts[*rc::gen::inRange(0, 7)];
  const bool limited = *rc::gen::arbitrary<bool>();
  const auto weights = *rc::gen::arbitrary<bool>() ? LumaWeights::bt601 : LumaWeights::bt709;
  const double x0 = *rc::gen::inRange(10000, 90000) * 1e-2, slope = *rc::gen::inRange(-60, 61) * 1e-2;
  const double width = *rc::gen::inRange(80, 650) * 1e-2, amplitude = *rc::gen::inRange(30, 600);
  const auto level = [] { return static_cast<double>(*rc::gen::inRange(20, 220)); };
  const Rgb left{level(), level(), level()}, right{level(), level(), level()};
  constexpr int kRows = 16;
  const auto at = [&](double y) { return x0 + slope * y; };
  const ColourPicture picture =
      picture_of(kWidth, kRows, {layout, 0, weights, limited}, [&](double x, double y) -> Rgb {
        const double off = (x - at(y)) / width, line = amplitude * std::exp(-off * off / 2);
        const Rgb& side = x < at(y) ? left : right;
        return {side[0] + line, side[1] + 0.3 * line, side[2] + 0.1 * line};
      });
  std::vector<LineRow> rows;
  for (int y = 0; y < kRows; ++y) rows.push_back(row_at(at(y), width));
  const auto found = colours_of(picture, rows);
  RC_ASSERT(found.size() == rows.size());
  for (const SampleColour& c : found) {
    // Coded chroma is rounded, and widened up to 1.86 times.
    RC_ASSERT(std::abs(c.red - (left[0] + right[0]) / 2) <= 2);
    RC_ASSERT(std::abs(c.green - (left[1] + right[1]) / 2) <= 2);
    RC_ASSERT(std::abs(c.blue - (left[2] + right[2]) / 2) <= 2);
  }
}

// On a surface whose colour changes evenly the mean is the colour where the line is, to the pixel that windows are
// placed by.
RC_GTEST_PROP(SurfaceColour, BelongsToThePlaceOfItsSample, ()) {
  const auto layout = kLayouts[*rc::gen::inRange(0, 7)];
  const double x0 = *rc::gen::inRange(10000, 90000) * 1e-2, width = *rc::gen::inRange(80, 650) * 1e-2;
  const double gradient = *rc::gen::inRange(-200, 201) * 1e-2;  // levels a pixel
  const ColourPicture picture = picture_of(kWidth, 8, {layout}, [&](double x, double) -> Rgb {
    const double level = 120 + gradient * (x - x0);
    return {level, 120, 240 - level};
  });
  const std::vector<LineRow> rows(8, row_at(x0, width));
  for (const SampleColour& c : colours_of(picture, rows)) {
    RC_ASSERT(std::abs(c.red - 120) <= 1.0 * std::abs(gradient) + 1.5);
    RC_ASSERT(std::abs(c.blue - 120) <= 1.0 * std::abs(gradient) + 1.5);
    RC_ASSERT(std::abs(c.green - 120) <= 1.5);
  }
}

TEST(SurfaceColour, OfACameraOnItsSideIsTheSame) {
  for (const ColourLayout layout : kLayouts) {
    const auto at = [](double along, double across) -> Rgb { return {60 + across, along < 300 ? 40. : 90., 150}; };
    const ColourPicture picture = picture_of(kWidth, 640, {layout}, [&](double x, double y) { return at(y, x / 10); });
    std::vector<LineRow> columns;
    for (int x = 0; x < kWidth; ++x) columns.push_back(row_at(x < 600 ? 200 : 400, 2));
    const auto found = colours_of(picture, columns, LineAlong::columns);
    ASSERT_EQ(found.size(), columns.size());
    for (std::size_t x = 0; x < found.size(); ++x) {
      const double across = static_cast<double>(x) / 10;
      expect_near(found[x], at(x < 600 ? 200 : 400, across), 2, std::to_string(x));
    }
  }
}

// What a side does not tell is taken from the other, at its own place; where neither tells, the sample has no colour.
TEST(SurfaceColour, OneSideDoesWhereTheOtherTellsNothing) {
  const Rgb good{90, 60, 120}, dark{5, 10, 3}, saturated{255, 60, 60}, bright{254, 254, 254};
  for (const ColourLayout layout : kLayouts) {
    for (const Rgb& bad : {dark, saturated, bright}) {
      const std::string what = std::to_string(static_cast<int>(layout)) + ", " + std::to_string(bad[0]);
      const auto scanned = [&](const Rgb& left, const Rgb& right) {
        const auto picture = picture_of(kWidth, 4, {layout}, [&](double x, double) { return x < 500 ? left : right; });
        const std::vector<LineRow> rows(4, row_at(500, 2));
        return colours_of(picture, rows);
      };
      for (const SampleColour& c : scanned(good, bad)) expect_near(c, good, 2, what);
      for (const SampleColour& c : scanned(bad, good)) expect_near(c, good, 2, what);
      for (const SampleColour& c : scanned(bad, bad)) EXPECT_FALSE(c.known()) << what;
    }
  }
}

TEST(SurfaceColour, OneSaturatedPixelSpoilsItsSide) {
  for (const ColourLayout layout : kLayouts) {
    const auto picture = picture_of(kWidth, 4, {layout}, [](double x, double) -> Rgb {
      return x >= 512 && x < 514 ? Rgb{255, 255, 255} : x < 500 ? Rgb{90, 60, 120} : Rgb{40, 40, 40};
    });
    // The window of a line at 500 of width 2 begins at pixel 510 and has four.
    const std::vector<LineRow> rows(4, row_at(500, 2));
    for (const SampleColour& c : colours_of(picture, rows)) expect_near(c, {90, 60, 120}, 2, "left alone");
  }
}

TEST(SurfaceColour, TheCamerasOwnSaturatedLevelCounts) {
  for (const ColourLayout layout : {ColourLayout::yuyv, ColourLayout::uv_pairs, ColourLayout::uv_cells}) {
    auto picture = picture_of(kWidth, 4, {layout}, [](double x, double) {
      return x < 500 ? Rgb{90, 60, 120} : Rgb{210, 210, 210};
    });
    const std::vector<LineRow> rows(4, row_at(500, 2));
    for (const SampleColour& c : colours_of(picture, rows)) expect_near(c, {150, 135, 165}, 2, "both sides");
    picture.mode.saturated_level = 200;
    for (const SampleColour& c : colours_of(picture, rows)) expect_near(c, {90, 60, 120}, 2, "left alone");
  }
}

TEST(SurfaceColour, BesideTheBorderOnlyTheInnerSideIsRead) {
  for (const ColourLayout layout : kLayouts) {
    const auto picture = picture_of(kWidth, 4, {layout}, [](double x, double) {
      return x < 640 ? Rgb{90, 60, 120} : Rgb{30, 160, 70};
    });
    for (const double x : {0., 3., 12.9}) {
      for (const SampleColour& c : colours_of(picture, std::vector<LineRow>(4, row_at(x, 2))))
        expect_near(c, {90, 60, 120}, 2, "left border");
      for (const SampleColour& c : colours_of(picture, std::vector<LineRow>(4, row_at(kWidth - 1 - x, 2))))
        expect_near(c, {30, 160, 70}, 2, "right border");
    }
  }
}

// A round body's pixels are those whose rays come nearer to the axis than its radius; beyond is the room.
TEST(SurfaceColour, ThePixelBesideTheBodyIsNotItsColour) {
  const Calibration c = test_calibration();
  const Triangulator triangulator(c, 0, kWhole);
  // Where row 500 passes the axis at 10 mm, to the left: by bisection.
  double inner = c.camera_model.cx_px.value, outer = 0;
  ASSERT_TRUE(triangulator.meets_radius(inner, 500, 10));
  ASSERT_FALSE(triangulator.meets_radius(outer, 500, 10));
  while (inner - outer > 1e-6) {
    const double middle = 0.5 * (inner + outer);
    (triangulator.meets_radius(middle, 500, 10) ? inner : outer) = middle;
  }
  const Rgb body{90, 60, 120}, room{30, 160, 70};
  const auto picture =
      picture_of(kWidth, kHeight, {ColourLayout::yuyv}, [&](double x, double) { return x < inner ? room : body; });
  std::vector<LineRow> rows(kHeight);
  rows[500] = row_at(inner + 5, 1);  // the window to the left lies beyond the silhouette
  const auto found = colours_of(picture, rows, LineAlong::rows, 10);
  ASSERT_EQ(found.size(), 1u);
  expect_near(found[0], body, 2, "inside alone");
  const auto wider = colours_of(picture, rows, LineAlong::rows, 40);
  expect_near(wider[0], {60, 110, 95}, 2, "of a body that reaches further");
}

TEST(SurfaceColour, RaysMeetARadiusWhereTheyComeSoNearToTheAxis) {
  Calibration c = test_calibration();
  const Triangulator triangulator(c, 0, kWhole);
  std::mt19937 random(8);
  std::uniform_real_distribution<double> x_px(0, kWidth), y_px(0, kHeight);
  int inside = 0;
  for (int i = 0; i < 2000; ++i) {
    const double x = x_px(random), y = y_px(random);
    const UndistortedPoint ray = Lens(c.camera_model).undistort(x, y);
    // The nearest approach to the axis by looking along the ray, instead of by a cross product.
    const Eigen::Isometry3d X_WC = c.axis.X_CW.inverse();
    const Eigen::Vector3d from = X_WC.translation(), along = X_WC.linear() * Eigen::Vector3d(ray.a, ray.b, 1);
    const double t = -(from.head<2>().dot(along.head<2>())) / along.head<2>().squaredNorm();
    const double nearest = c.scale.value * (from + t * along).head<2>().norm();
    if (std::abs(nearest - 25) < 1e-6) continue;
    EXPECT_EQ(triangulator.meets_radius(x, y, 25), nearest < 25) << x << ", " << y;
    inside += nearest < 25;
  }
  EXPECT_GT(inside, 100);
}

TEST(SurfaceColour, AGreyCameraHasNone) {
  ColourPicture picture = picture_of(kWidth, 4, {ColourLayout::uv_pairs}, [](double, double) { return Rgb{9, 99, 9}; });
  const std::vector<LineRow> rows(4, row_at(500, 2));
  // A picture without colours among others that have them, as of a grey JPEG.
  picture.colour.clear();
  for (const SampleColour& c : colours_of(picture, rows)) EXPECT_FALSE(c.known());
  picture.mode.colour = {};
  EXPECT_TRUE(colours_of(picture, rows).empty());
}

TEST(SurfaceColour, RowsWithoutALineAreNotLookedAt) {
  const auto picture = picture_of(kWidth, 8, {ColourLayout::yuyv}, [](double, double) { return Rgb{90, 60, 120}; });
  std::vector<LineRow> rows(8, row_at(500, 2));
  rows[2] = LineRow();
  rows[5].status = RowStatus::ambiguous;
  rows[6].status = RowStatus::saturated;
  const auto found = colours_of(picture, rows);
  ASSERT_EQ(found.size(), 6u);
  for (const SampleColour& c : found) EXPECT_TRUE(c.known());
}

}  // namespace
}  // namespace celadon
