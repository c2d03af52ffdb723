// What LaserLineExtractor finds, refuses and leaves alone: agreement of the SIMD targets with a scalar reference,
// formats, memory layouts, frames without a line, ambiguity, borders.

#include "acquisition/laser_line.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <memory>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/acquisition/extracted_rows.h"
#include "tests/acquisition/laser_line_reference.h"
#include "tests/acquisition/simd_targets.h"
#include "tests/acquisition/synthetic_line.h"

namespace celadon {
namespace {

using synthetic::mode_of;
using Bytes = std::vector<std::uint8_t>;

int count_status(const std::vector<LineRow>& rows, RowStatus status) {
  return static_cast<int>(
      std::count_if(rows.begin(), rows.end(), [&](const LineRow& r) { return r.status == status; }));
}

/// YUYV with the grey values as luma and noise as chroma.
Bytes yuyv_with_luma(const Bytes& grey, unsigned seed) {
  std::mt19937 random(seed);
  Bytes yuyv;
  for (const std::uint8_t value : grey) {
    yuyv.push_back(value);
    yuyv.push_back(static_cast<std::uint8_t>(random() & 255));
  }
  return yuyv;
}

/// YUYV whose red (1) or green (2) channel is the grey picture, and whose luma hides the line.
Bytes yuyv_with_colour(const Bytes& grey, LineChannel channel) {
  Bytes yuyv(grey.size() * 2);
  for (std::size_t i = 0; i < grey.size(); i += 2) {
    const double value = (grey[i] + grey[i + 1]) / 2.0, luma = 60;
    const double v = channel == LineChannel::red ? (value - luma) / 1.4 : -(value - luma) / 0.71;
    const auto byte = [](double x) { return static_cast<std::uint8_t>(std::clamp(x, 0.0, 255.0)); };
    yuyv[2 * i] = byte(luma + grey[i] - value);
    yuyv[2 * i + 2] = byte(luma + grey[i + 1] - value);
    yuyv[2 * i + 1] = 128;
    yuyv[2 * i + 3] = static_cast<std::uint8_t>(std::clamp(std::lround(128 + v), 0L, 255L));
  }
  return yuyv;
}

void expect_agreement(const std::vector<LineRow>& rows, const std::vector<LineRow>& expected) {
  int other_status = 0;
  for (std::size_t y = 0; y < rows.size(); ++y) {
    if (rows[y].status != expected[y].status) {
      ++other_status;  // rounding may decide a row at a threshold
      continue;
    }
    if (expected[y].x_px < 0) {
      EXPECT_EQ(rows[y].x_px, -1.f) << "row " << y;
      continue;
    }
    EXPECT_NEAR(rows[y].x_px, expected[y].x_px, 0.01) << "row " << y;
    EXPECT_NEAR(rows[y].sigma_px, expected[y].sigma_px, 0.02 * expected[y].sigma_px + 1e-3) << "row " << y;
    EXPECT_NEAR(rows[y].width_px, expected[y].width_px, 0.02) << "row " << y;
    EXPECT_NEAR(rows[y].amplitude, expected[y].amplitude, 0.01 * expected[y].amplitude + 0.1) << "row " << y;
  }
  EXPECT_LE(other_status, static_cast<int>(rows.size()) / 200);
}

TEST(LaserLine, EverySimdTargetAgreesWithTheScalarReference) {
  const LaserLineOptions options;
  for (const int width : {64, 68, 126, 130, 640, 1000}) {
    SCOPED_TRACE(width);
    const auto picture = synthetic::scan_frame(width, 200, synthetic::nominal_scene(), 11);
    const CameraMode mode = mode_of(width, 200);
    const reference::Frame on{mode, LineChannel::luma, picture.on.data()},
        off{mode, LineChannel::luma, picture.off.data()};
    const auto alone = reference::extract(on, nullptr, options), difference = reference::extract(on, &off, options);
    if (width >= 640) {
      ASSERT_GT(count_status(alone, RowStatus::found), 130);
    }
    if (width >= 640) {
      ASSERT_GT(count_status(alone, RowStatus::saturated), 5);
    }
    on_every_target([&] {
      expect_agreement(extract(mode, picture.on), alone);
      expect_agreement(extract(mode, picture.on, picture.off), difference);
    });
  }
}

TEST(LaserLine, EverySimdTargetAgreesWithTheScalarReferenceOnColour) {
  for (const LineChannel channel : {LineChannel::luma, LineChannel::red, LineChannel::green}) {
    for (const int width : {64, 640}) {
      SCOPED_TRACE(width);
      const auto picture = synthetic::scan_frame(width, 200, synthetic::nominal_scene(), 12);
      const CameraMode mode = mode_of(width, 200, PixelFormat::yuyv);
      LaserLineOptions options;
      options.channel = channel;
      const auto convert = [&](const Bytes& grey) {
        return channel == LineChannel::luma ? yuyv_with_luma(grey, 5) : yuyv_with_colour(grey, channel);
      };
      const Bytes on_bytes = convert(picture.on), off_bytes = convert(picture.off);
      const reference::Frame on{mode, channel, on_bytes.data()}, off{mode, channel, off_bytes.data()};
      const auto alone = reference::extract(on, nullptr, options), difference = reference::extract(on, &off, options);
      if (width == 640) {
        ASSERT_GT(count_status(alone, RowStatus::found), 100);
      }
      on_every_target([&] {
        expect_agreement(extract(mode, on_bytes, {}, options), alone);
        expect_agreement(extract(mode, on_bytes, off_bytes, options), difference);
      });
    }
  }
}

TEST(LaserLine, ColourChannelFindsWhatLumaHides) {
  const auto picture = synthetic::scan_frame(640, 300, synthetic::good_scene(), 3);
  for (const LineChannel channel : {LineChannel::red, LineChannel::green}) {
    LaserLineOptions options;
    const Bytes yuyv = yuyv_with_colour(picture.on, channel);
    const CameraMode mode = mode_of(640, 300, PixelFormat::yuyv);
    EXPECT_LT(count_status(extract(mode, yuyv, {}, options), RowStatus::found), 60) << "luma";
    options.channel = channel;
    const auto rows = extract(mode, yuyv, {}, options);
    synthetic::Score score;
    for (std::size_t y = 0; y < rows.size(); ++y) score.add(picture.truth, y, rows[y].x_px);
    EXPECT_LT(score.miss_percent(), 1) << static_cast<int>(channel);
    EXPECT_LT(score.rms(), 0.3) << "chroma has half the resolution";
  }
}

TEST(LaserLine, LumaOfYuyvIsGreyExceptAtSaturation) {
  auto scene = synthetic::nominal_scene();
  scene.saturation = false;
  scene.amplitude = 90;  // below the level from which YUYV counts as saturated
  const auto picture = synthetic::scan_frame(640, 300, scene, 4);
  const auto grey = extract(mode_of(640, 300), picture.on, picture.off);
  const Bytes on = yuyv_with_luma(picture.on, 1), off = yuyv_with_luma(picture.off, 2);
  const auto yuyv = extract(mode_of(640, 300, PixelFormat::yuyv), on, off);
  for (std::size_t y = 0; y < grey.size(); ++y) {
    EXPECT_EQ(grey[y].x_px, yuyv[y].x_px) << y;
    EXPECT_EQ(grey[y].sigma_px, yuyv[y].sigma_px) << y;
    EXPECT_EQ(grey[y].status, yuyv[y].status) << y;
  }
}

// Buffers of the exact size on the heap: the address sanitizer sees a read beyond either end.
TEST(LaserLine, AnyStrideAndAlignmentGivesTheSameRows) {
  const int height = 40;
  for (const int width : {64, 65, 67, 99, 131, 254, 640}) {
    for (const bool yuyv : {false, true}) {
      if (yuyv && width % 2 != 0) continue;
      const auto picture =
          synthetic::straight_line(width, height, width / 2.0, 0.05, 2.5, synthetic::nominal_scene(), 9);
      const Bytes tight_on = yuyv ? yuyv_with_luma(picture.on, 1) : picture.on;
      const Bytes tight_off = yuyv ? yuyv_with_luma(picture.off, 1) : picture.off;
      const PixelFormat format = yuyv ? PixelFormat::yuyv : PixelFormat::grey8;
      const std::size_t row_bytes = static_cast<std::size_t>(width) * bytes_per_pixel(format);
      const auto expected = extract(mode_of(width, height, format), tight_on, tight_off);
      ASSERT_GT(count_status(expected, RowStatus::found), height / 2) << width;
      for (const std::size_t padding : {0u, 1u, 3u, 13u, 64u}) {
        for (const std::size_t shift : {0u, 1u, 7u}) {
          const std::size_t stride = row_bytes + padding;
          const std::size_t size = stride * (height - 1) + row_bytes;
          const auto place = [&](const Bytes& tight) {
            auto buffer = std::make_unique<std::uint8_t[]>(shift + size);
            for (std::size_t y = 0; y < height; ++y) {
              std::memcpy(buffer.get() + shift + y * stride, tight.data() + y * row_bytes, row_bytes);
            }
            return buffer;
          };
          const auto on = place(tight_on), off = place(tight_off);
          const auto rows =
              extract(mode_of(width, height, format, stride), {on.get() + shift, size}, {off.get() + shift, size});
          for (std::size_t y = 0; y < height; ++y) {
            ASSERT_EQ(rows[y].x_px, expected[y].x_px) << width << " " << padding << " " << shift << " row " << y;
          }
        }
      }
    }
  }
}

TEST(LaserLine, RefusesImpossibleArguments) {
  LaserLineExtractor extractor;
  std::vector<LineRow> rows(8);
  const Bytes frame(8 * 8192);
  const auto message = [&](const CameraMode& mode, std::size_t bytes, std::size_t off_bytes = 0,
                           std::size_t count = 8) {
    try {
      extractor.extract(mode, {frame.data(), bytes}, {frame.data(), off_bytes}, {rows.data(), count});
    } catch (const std::invalid_argument& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_EQ(message(mode_of(640, 8), 640 * 8), "");
  EXPECT_EQ(message(mode_of(4096, 8), 4096 * 8), "");
  EXPECT_NE(message(mode_of(63, 8), frame.size()).find("63x8, width must be 64 to 4096"), std::string::npos);
  EXPECT_NE(message(mode_of(4097, 8), frame.size()).find("width must be 64 to 4096"), std::string::npos);
  EXPECT_NE(message(mode_of(65, 8, PixelFormat::yuyv), frame.size()).find("even width"), std::string::npos);
  EXPECT_NE(message(mode_of(640, 8, PixelFormat::grey8, 639), frame.size()).find("stride"), std::string::npos);
  EXPECT_NE(message(mode_of(640, 8), 640 * 8 - 1).find("5119 bytes"), std::string::npos);
  EXPECT_NE(message(mode_of(640, 8), 640 * 8, 100).find("laser-off"), std::string::npos);
  EXPECT_NE(message(mode_of(640, 8), 640 * 8, 0, 7).find("7 rows"), std::string::npos);
  EXPECT_NE(message(mode_of(640, 0), 640 * 8).find("height"), std::string::npos);
  LaserLineOptions options;
  options.minimum_contrast = 0;
  EXPECT_THROW(LaserLineExtractor{options}, std::invalid_argument);
  options = {};
  options.electrons_per_level = 0;
  EXPECT_THROW(LaserLineExtractor{options}, std::invalid_argument);
}

TEST(LaserLine, FlatFramesAndEdgesHaveNoLine) {
  for (const int level : {0, 1, 128, 249, 255}) {
    const Bytes frame(640 * 16, static_cast<std::uint8_t>(level));
    EXPECT_EQ(count_status(extract(mode_of(640, 16), frame), RowStatus::no_line), 16) << level;
    EXPECT_EQ(count_status(extract(mode_of(640, 16), frame, frame), RowStatus::no_line), 16) << level;
  }
  Bytes step(640 * 16), ramp(640 * 16), bar(640 * 16);
  for (std::size_t i = 0; i < step.size(); ++i) {
    const std::size_t x = i % 640;
    step[i] = x < 300 ? 20 : 220;
    ramp[i] = static_cast<std::uint8_t>(x * 255 / 640);
    bar[i] = x > 200 && x < 400 ? 200 : 20;  // a bright object, not a line
  }
  for (const Bytes* frame : {&step, &ramp, &bar}) {
    EXPECT_EQ(count_status(extract(mode_of(640, 16), *frame), RowStatus::no_line), 16);
  }
}

// Stated in README.md: of rows of white noise alone, at most one in 500 is taken for a line.
TEST(LaserLine, NoiseIsNoLine) {
  for (const double sigma : {1.5, 5.0, 20.0, 60.0}) {
    std::mt19937 random(7);
    std::normal_distribution<double> normal(100, sigma);
    Bytes on(1280 * 1000), off(on.size());
    for (auto* frame : {&on, &off}) {
      for (auto& value : *frame) value = static_cast<std::uint8_t>(std::clamp(std::lround(normal(random)), 0L, 255L));
    }
    for (const bool subtract : {false, true}) {
      const auto rows = extract(mode_of(1280, 1000), on,
                                subtract ? std::span<const std::uint8_t>(off) : std::span<const std::uint8_t>());
      EXPECT_LE(count_status(rows, RowStatus::found) + count_status(rows, RowStatus::saturated), 2)
          << sigma << (subtract ? " difference" : "");
    }
  }
}

TEST(LaserLine, SecondLineIsFlaggedNotGuessed) {
  auto scene = synthetic::good_scene();
  scene.speckle_contrast = 0.05;
  scene.amplitude = 120;
  const auto flagged = [&](double share) {
    synthetic::Truth truth;
    for (int y = 0; y < 400; ++y) {
      truth.center_px.push_back(250 + 0.1 * y);
      truth.width_px.push_back(3);
      truth.amplitude.push_back(scene.amplitude);
      truth.kind.push_back(synthetic::RowKind::line);
    }
    const auto second = [&](int x, int y) {
      const double u = (x - 400 - 0.1 * y) / 3;
      return share * scene.amplitude * std::exp(-0.5 * u * u);
    };
    const auto picture = synthetic::draw(
        640, 400, truth, scene, 21, [](int, int) { return 15.0; }, second);
    const auto rows = extract(mode_of(640, 400), picture.on, picture.off);
    for (std::size_t y = 0; y < rows.size(); ++y) {
      if (rows[y].x_px >= 0 && share < 0.9) {
        EXPECT_NEAR(rows[y].x_px, truth.center_px[y], 1.0);
      }
    }
    return count_status(rows, RowStatus::ambiguous);
  };
  EXPECT_EQ(flagged(0.5), 0);
  EXPECT_LE(flagged(0.6), 8);
  EXPECT_GE(flagged(0.8), 392);
  EXPECT_EQ(flagged(1.0), 400);
}

TEST(LaserLine, AtTheBorderALineIsWholeOrMissing) {
  auto scene = synthetic::good_scene();
  scene.speckle_contrast = 0;
  for (const int width : {64, 320, 321}) {
    for (double distance = 0; distance < 30; distance += 0.7) {
      for (const bool left : {true, false}) {
        const double center = left ? distance : width - 1 - distance;
        const auto picture = synthetic::straight_line(width, 8, center, 0, 2, scene, 31);
        const auto rows = extract(mode_of(width, 8), picture.on);
        for (const LineRow& row : rows) {
          if (row.x_px >= 0) {
            EXPECT_NEAR(row.x_px, center, 0.15) << width << " at " << center;
          }
          if (distance < 3.5) {
            EXPECT_EQ(row.status, RowStatus::no_line) << width << " at " << center;
          }
          if (distance > 14) {
            EXPECT_EQ(row.status, RowStatus::found) << width << " at " << center;
          }
        }
      }
    }
  }
}

// Luma of limited range ends at 235, whatever its format is called.
TEST(LaserLine, TheModeSaysFromWhereSamplesAreSaturated) {
  auto scene = synthetic::good_scene();
  scene.speckle_contrast = 0;
  scene.amplitude = 600;
  auto picture = synthetic::straight_line(320, 40, 140.3, 0.05, 3.0, scene, 7);
  for (std::uint8_t& level : picture.on) level = std::min<std::uint8_t>(level, 235);
  CameraMode mode = mode_of(320, 40);
  EXPECT_EQ(count_status(extract(mode, picture.on), RowStatus::saturated), 0);
  mode.saturated_level = 235;
  EXPECT_EQ(count_status(extract(mode, picture.on), RowStatus::saturated), 40);
  mode.saturated_level = 256;
  EXPECT_THROW(extract(mode, picture.on), std::invalid_argument);
}

TEST(LaserLine, FlatTopsAreSaturatedAndKeepTheirPosition) {
  auto scene = synthetic::good_scene();
  scene.speckle_contrast = 0;
  for (const double amplitude : {300.0, 600.0, 2000.0}) {
    for (const double line_width : {1.5, 3.0, 4.5}) {
      scene.amplitude = amplitude;
      synthetic::Score score;
      for (int i = 0; i < 10; ++i) {
        const auto picture =
            synthetic::straight_line(320, 40, 140 + 0.37 * i, 0.05, line_width, scene, 40u + static_cast<unsigned>(i));
        const auto rows = extract(mode_of(320, 40), picture.on);
        for (std::size_t y = 0; y < rows.size(); ++y) {
          EXPECT_EQ(rows[y].status, RowStatus::saturated);
          score.add(picture.truth, y, rows[y].x_px, static_cast<double>(rows[y].sigma_px));
        }
      }
      EXPECT_EQ(score.missed + score.outliers, 0) << amplitude << " " << line_width;
      EXPECT_LT(score.rms(), 0.06) << amplitude << " " << line_width;
      EXPECT_LT(std::abs(score.mean()), 0.02) << amplitude << " " << line_width;
    }
  }
}

}  // namespace
}  // namespace celadon
