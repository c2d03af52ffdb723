// What a scan says of the room's light, against pictures made by hand.

#include "daemon/room_light_watch.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>
#include <random>
#include <vector>

namespace celadon {
namespace {

constexpr int kWidth = 640, kHeight = 480;

CameraMode mode_of(PixelFormat format) {
  CameraMode mode;
  mode.width_px = kWidth;
  mode.height_px = kHeight;
  mode.format = format;
  mode.stride_bytes = static_cast<std::size_t>(kWidth) * bytes_per_pixel(format) + 32;
  return mode;
}

/// A gradient with noise; a line with a wide glow (at an x, along columns at a y), and an object's bright patch that
/// covers a share of the width and moves.
struct Room {
  CameraMode mode = mode_of(PixelFormat::grey8);
  LineAlong along = LineAlong::rows;
  float line_px = 300;
  std::mt19937 random{7};

  std::vector<std::uint8_t> picture(double level, bool laser, int patch_from, int patch_to) {
    std::normal_distribution<double> noise(0, 1.5);
    const std::size_t step = bytes_per_pixel(mode.format);
    std::vector<std::uint8_t> out(mode.stride_bytes * kHeight, 128);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < mode.width_px; ++x) {
        const int across = along == LineAlong::rows ? x : y;
        double v = level + 0.02 * x + noise(random);
        if (x >= patch_from && x < patch_to) v += 60;
        if (laser && std::abs(static_cast<float>(across) - line_px) < 30) v += 120;
        out[static_cast<std::size_t>(y) * mode.stride_bytes + static_cast<std::size_t>(x) * step] =
            static_cast<std::uint8_t>(std::clamp(v, 0., 255.));
      }
    }
    return out;
  }
  std::vector<LineRow> rows() const {
    LineRow row;
    row.x_px = line_px;
    row.status = RowStatus::found;
    return std::vector<LineRow>(static_cast<std::size_t>(along == LineAlong::rows ? kHeight : kWidth), row);
  }
};

RoomLightReading reading_of(Room room, const std::vector<double>& levels, double of_background = 20) {
  RoomLightWatch watch;
  const auto background = room.picture(of_background, false, 200, 330);
  for (std::size_t k = 0; k < levels.size(); ++k) {
    const int moved = static_cast<int>(k % 5) * 10;
    watch.see(room.mode, room.picture(levels[k], true, 200 + moved, 330 + moved), background, room.rows(), room.along,
              static_cast<double>(k) / 10);
  }
  return watch.reading();
}

TEST(RoomLightWatch, SteadyLightPassesWhateverTheObjectDoes) {
  for (const LineAlong along : {LineAlong::rows, LineAlong::columns}) {
    for (const PixelFormat format : {PixelFormat::grey8, PixelFormat::yuyv}) {
      Room room;
      room.along = along;
      room.mode = mode_of(format);
      const RoomLightReading reading = reading_of(room, std::vector<double>(12, 20));
      EXPECT_EQ(reading.frames, 12u);
      EXPECT_LT(std::abs(reading.change_levels), 0.5);
      EXPECT_EQ(room_light_check(reading, 150).verdict, CheckVerdict::passed);
    }
  }
}

TEST(RoomLightWatch, ALampIsNamedWithItsPlaceAndBothSenses) {
  std::vector<double> levels(20, 20);
  std::fill(levels.begin() + 8, levels.end(), 45);
  const RoomLightReading brighter = reading_of({}, levels);
  EXPECT_NEAR(brighter.change_levels, 25, 0.5);
  EXPECT_GE(brighter.at_rad, 0.8);
  EXPECT_LE(brighter.at_rad, 1.9);
  const SelfCheck check = room_light_check(brighter, 150);
  EXPECT_EQ(check.verdict, CheckVerdict::failed);
  EXPECT_NE(check.cause.find("brighter"), std::string::npos) << check.cause;
  EXPECT_NE(check.remedy.find("steps"), std::string::npos);

  std::fill(levels.begin() + 8, levels.end(), 20);
  std::fill(levels.begin(), levels.begin() + 8, 45);
  const SelfCheck darker = room_light_check(reading_of({}, std::vector<double>(12, 20), 45), 150);
  EXPECT_EQ(darker.verdict, CheckVerdict::failed);
  EXPECT_NE(darker.cause.find("darker"), std::string::npos) << darker.cause;
}

TEST(RoomLightWatch, ALinesGlowIsNotTheRooms) {
  Room room;
  room.mode.width_px = 120;
  room.line_px = 60;
  EXPECT_LT(std::abs(reading_of(room, std::vector<double>(12, 20)).change_levels), 0.5);
}

TEST(RoomLightWatch, ABrightLineBearsMore) {
  RoomLightReading reading;
  reading.frames = 10;
  for (const double change : {-10., 10.}) {
    reading.change_levels = change;
    EXPECT_EQ(room_light_check(reading, 150).verdict, CheckVerdict::passed);
    EXPECT_EQ(room_light_check(reading, 80).verdict, CheckVerdict::failed);
  }
  reading.change_levels = 5;  // which hardly adds noise, however dark the line
  EXPECT_EQ(room_light_check(reading, 20).verdict, CheckVerdict::passed);
}

TEST(RoomLightWatch, OneFrameAloneIsNoLamp) {
  std::vector<double> levels(20, 20);
  levels[9] = 40;  // a flash
  EXPECT_LT(std::abs(reading_of({}, levels).change_levels), 0.5);
}

TEST(RoomLightWatch, ANewBackgroundBeginsAnew) {
  Room room;
  RoomLightWatch watch;
  const auto dark = room.picture(20, false, 0, 0), lit = room.picture(45, false, 0, 0);
  const auto see = [&](const std::vector<std::uint8_t>& background) {
    return watch.see(room.mode, room.picture(45, true, 0, 0), background, room.rows(), room.along, 0);
  };
  EXPECT_GT(see(dark), kRenewBackground_levels);
  watch.renewed();
  for (int k = 0; k < 10; ++k) EXPECT_LT(std::abs(see(lit)), 0.5);
  EXPECT_LT(std::abs(watch.reading().change_levels), 0.5) << "only one frame was subtracted a wrong background";
  EXPECT_EQ(watch.reading().renewed_backgrounds, 1);
  // Frames before and after a new background are not of one row.
  for (int k = 0; k < 3; ++k) see(dark);
  watch.renewed();
  see(dark);
  EXPECT_LT(std::abs(watch.reading().change_levels), 0.5);
}

TEST(RoomLightWatch, WithoutABackgroundNothingIsSaid) {
  Room room;
  RoomLightWatch watch;
  EXPECT_EQ(watch.see(room.mode, room.picture(20, true, 0, 0), {}, room.rows(), room.along, 0), 0);
  const SelfCheck check = room_light_check(watch.reading(), 150);
  EXPECT_EQ(check.verdict, CheckVerdict::not_verifiable);
  EXPECT_FALSE(check.note.empty());
}

}  // namespace
}  // namespace celadon
