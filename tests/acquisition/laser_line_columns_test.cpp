// Lines along the columns of the frame: what the rows of the transposed picture give, formats, sizes, layouts, and
// truth.

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <memory>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "acquisition/laser_line.h"
#include "tests/acquisition/laser_line_reference.h"
#include "tests/acquisition/simd_targets.h"
#include "tests/acquisition/synthetic_line.h"

namespace celadon {
namespace {

using synthetic::mode_of;
using Bytes = std::vector<std::uint8_t>;

std::vector<LineRow> extract_along(LineAlong along, const CameraMode& mode, std::span<const std::uint8_t> on,
                                   std::span<const std::uint8_t> off, LaserLineOptions options = {},
                                   std::span<const LineRow> previous = {}) {
  options.along = along;
  const int count = along == LineAlong::rows ? mode.height_px : mode.width_px;
  std::vector<LineRow> rows(static_cast<std::size_t>(count));
  LaserLineExtractor(options).extract(mode, on, off, rows, previous);
  return rows;
}

Bytes transposed(const Bytes& grey, int width, int height) {
  const auto w = static_cast<std::size_t>(width), h = static_cast<std::size_t>(height);
  Bytes out(grey.size());
  for (std::size_t y = 0; y < h; ++y) {
    for (std::size_t x = 0; x < w; ++x) out[x * h + y] = grey[y * w + x];
  }
  return out;
}

void expect_same(const std::vector<LineRow>& columns, const std::vector<LineRow>& rows, const std::string& what) {
  ASSERT_EQ(columns.size(), rows.size()) << what;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    ASSERT_EQ(columns[i].x_px, rows[i].x_px) << what << " " << i;
    ASSERT_EQ(columns[i].sigma_px, rows[i].sigma_px) << what << " " << i;
    ASSERT_EQ(columns[i].amplitude, rows[i].amplitude) << what << " " << i;
    ASSERT_EQ(columns[i].width_px, rows[i].width_px) << what << " " << i;
    ASSERT_EQ(columns[i].status, rows[i].status) << what << " " << i;
  }
}

// Buffers of the exact size on the heap: the address sanitizer sees a read beyond either end.
TEST(LaserLineAlongColumns, GivesTheRowsOfTheTransposedPicture) {
  for (const int length : {64, 65, 67, 79, 130, 640}) {
    for (const int count : {16, 17, 31, 100, 127, 128, 129, 144, 250}) {
      // Drawn upright, `length` wide; the frame is its transpose, `count` wide.
      const auto picture = synthetic::scan_frame(length, count, synthetic::nominal_scene(), 11);
      const auto expected = extract_along(LineAlong::rows, mode_of(length, count), picture.on, picture.off);
      const Bytes on = transposed(picture.on, length, count), off = transposed(picture.off, length, count);
      for (const std::size_t padding : {0u, 13u}) {
        const auto width = static_cast<std::size_t>(count), height = static_cast<std::size_t>(length);
        const std::size_t stride = width + padding, size = stride * (height - 1) + width;
        const auto place = [&](const Bytes& tight) {
          auto buffer = std::make_unique<std::uint8_t[]>(size);
          for (std::size_t y = 0; y < height; ++y) {
            std::memcpy(buffer.get() + y * stride, tight.data() + y * width, width);
          }
          return buffer;
        };
        const auto on_buffer = place(on), off_buffer = place(off);
        const auto columns = extract_along(LineAlong::columns, mode_of(count, length, PixelFormat::grey8, stride),
                                           {on_buffer.get(), size}, {off_buffer.get(), size});
        expect_same(columns, expected, std::to_string(count) + "x" + std::to_string(length));
      }
    }
  }
}

TEST(LaserLineAlongColumns, FindsALyingLineWhereItIs) {
  const auto picture = synthetic::scan_frame(1024, 1280, synthetic::nominal_scene(), 3);  // upright, 1024 wide
  const Bytes on = transposed(picture.on, 1024, 1280);
  on_every_target([&] {
    const auto columns = extract_along(LineAlong::columns, mode_of(1280, 1024), on, {});
    synthetic::Score score;
    for (std::size_t i = 0; i < columns.size(); ++i) score.add(picture.truth, i, columns[i].x_px);
    EXPECT_LE(score.rms(), 0.26);
    EXPECT_LE(score.outlier_percent(), 0.05);
    EXPECT_LE(score.miss_percent(), 0.2);
  });
}

// Colour is formed before the columns are turned, and limited to a byte: as the scalar reference forms it.
TEST(LaserLineAlongColumns, ColourIsThatOfTheScalarReference) {
  const int width = 250, height = 320;
  const auto picture = synthetic::scan_frame(height, width, synthetic::nominal_scene(), 12);
  std::mt19937 random(5);
  const auto yuyv_of = [&](const Bytes& upright) {
    const Bytes grey = transposed(upright, height, width);
    Bytes yuyv;
    for (std::size_t i = 0; i < grey.size(); ++i) {
      yuyv.push_back(grey[i]);
      yuyv.push_back(static_cast<std::uint8_t>(118 + random() % 20));
    }
    return yuyv;
  };
  const Bytes on = yuyv_of(picture.on), off = yuyv_of(picture.off);
  const CameraMode mode = mode_of(width, height, PixelFormat::yuyv);
  for (const LineChannel channel : {LineChannel::luma, LineChannel::red, LineChannel::green}) {
    const auto turned_grey = [&](const Bytes& yuyv) {
      const reference::Frame frame{mode, channel, yuyv.data()};
      Bytes out;
      for (int x = 0; x < width; ++x) {
        for (int y = 0; y < height; ++y)
          out.push_back(static_cast<std::uint8_t>(std::clamp(frame.signal(y, x), 0, 255)));
      }
      return out;
    };
    CameraMode turned = mode_of(height, width);
    turned.saturated_level = 235;
    LaserLineOptions options;
    options.channel = channel;
    on_every_target([&] {
      const auto expected = extract_along(LineAlong::rows, turned, turned_grey(on), turned_grey(off));
      expect_same(extract_along(LineAlong::columns, mode, on, off, options), expected,
                  "channel " + std::to_string(static_cast<int>(channel)));
    });
  }
}

// A second, brighter line over a stretch that crosses from one strip of columns to the next.
TEST(LaserLineAlongColumns, ContinuityChoosesAsInRows) {
  synthetic::Truth truth;
  for (int i = 0; i < 400; ++i) {
    truth.center_px.push_back(200 + 0.1 * i);
    truth.width_px.push_back(3);
    truth.amplitude.push_back(100);
    truth.kind.push_back(synthetic::RowKind::line);
  }
  const auto second = [](int x, int y) {
    const double u = (x - 320 - 0.05 * y) / 3;
    return y >= 70 && y < 290 ? 160 * std::exp(-0.5 * u * u) : 0;
  };
  const auto picture = synthetic::draw(
      480, 400, truth, synthetic::good_scene(), 9, [](int, int) { return 15.0; }, second);
  const Bytes on = transposed(picture.on, 480, 400), off = transposed(picture.off, 480, 400);
  const auto columns = extract_along(LineAlong::columns, mode_of(400, 480), on, off);
  expect_same(columns, extract_along(LineAlong::rows, mode_of(480, 400), picture.on, picture.off), "two lines");
  for (std::size_t i = 0; i < columns.size(); ++i) EXPECT_NEAR(columns[i].x_px, truth.center_px[i], 1.5) << i;
}

TEST(LaserLineAlongColumns, RefusesFramesTooLowOrTooNarrow) {
  const Bytes frame(64 * 5000);
  const auto message = [&](int width, int height, std::size_t count) {
    std::vector<LineRow> rows(count);
    try {
      LaserLineExtractor({.along = LineAlong::columns}).extract(mode_of(width, height), frame, {}, rows);
    } catch (const std::invalid_argument& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_EQ(message(16, 64, 16), "");
  EXPECT_EQ(message(64, 4096, 64), "");
  EXPECT_NE(message(64, 63, 64).find("height must be 64 to 4096"), std::string::npos);
  EXPECT_NE(message(64, 4097, 64).find("height must be 64 to 4096"), std::string::npos);
  EXPECT_NE(message(15, 64, 15).find("width must be at least 16"), std::string::npos);
  EXPECT_NE(message(64, 100, 100).find("100 rows given for a width of 64"), std::string::npos);
}

}  // namespace
}  // namespace celadon
