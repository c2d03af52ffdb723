// V4L2Source against the kernel's uvcvideo driver with a USB camera of the test's own; runs in the guest.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>
#include <memory>

#include "acquisition/frame.h"
#include "tests/vm/uvc_camera.h"

namespace celadon {
namespace {

using Exposure = UvcCamera::Exposure;
constexpr std::int64_t kPatience = 60'000'000'000;  // emulation is slow, and no test measures time

constexpr int kWidth = 320, kHeight = 240;

/// Byte of a pixel in the frame that begins with `first`.
std::uint8_t pixel(std::uint8_t first, int x, int y) {
  return static_cast<std::uint8_t>(first + 3 * x + 5 * y);
}

/// Sees another pattern in every frame.
UvcCamera::Sensor pattern() {
  return [first = std::uint8_t{0}](const Exposure&, std::span<std::uint8_t> pixels) mutable {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) pixels[static_cast<std::size_t>(y * kWidth + x)] = pixel(first, x, y);
    }
    ++first;
  };
}

std::unique_ptr<FrameSource> opened(const UvcCamera& camera) {
  auto source = open_frame_source("v4l2:" + camera.node());
  EXPECT_TRUE(source) << source.error().message;
  return source ? std::move(*source) : nullptr;
}

TEST(V4l2Uvc, exposure_reaches_the_camera_and_is_put_back) {
  const UvcCamera camera(kWidth, kHeight, pattern());
  const Exposure found = camera.exposure();
  auto source = opened(camera);
  ASSERT_TRUE(source);
  EXPECT_EQ(source->mode().exposure_ns, 0) << "the automatic sets it";
  EXPECT_EQ(source->mode().identity, "Test Camera CAM001");
  const auto set = source->set_exposure(5'000'000);
  ASSERT_TRUE(set) << set.error().message;
  EXPECT_EQ(*set, 5'000'000);
  EXPECT_EQ(camera.exposure(), (Exposure{UvcCamera::kManual, 50}));
  EXPECT_EQ(*source->set_exposure(1), 300'000);
  EXPECT_EQ(*source->set_exposure(10'000'000'000), 204'700'000);
  source.reset();
  EXPECT_EQ(camera.exposure(), found);
}

TEST(V4l2Uvc, frames_come_whole_and_exposure_is_put_back_after_streaming) {
  const UvcCamera camera(kWidth, kHeight, pattern());
  const Exposure found = camera.exposure();
  auto source = opened(camera);
  ASSERT_TRUE(source);
  EXPECT_EQ(source->mode().format, PixelFormat::grey8);
  EXPECT_EQ(source->mode().width_px, kWidth);
  EXPECT_EQ(source->mode().height_px, kHeight);
  ASSERT_TRUE(source->set_exposure(7'000'000));
  ASSERT_TRUE(source->start());
  std::int64_t last_stamp_ns = 0;
  for (int i = 0; i < 20; ++i) {
    const auto frame = source->next(kPatience);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_FALSE(frame->info.corrupt);
    EXPECT_EQ(frame->info.exposure_ns, 7'000'000);
    EXPECT_GT(frame->info.stamp_ns, last_stamp_ns);
    last_stamp_ns = frame->info.stamp_ns;
    int wrong = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const std::uint8_t seen = frame->bytes()[static_cast<std::size_t>(y * kWidth + x)];
        wrong += seen != pixel(frame->bytes()[0], x, y);
      }
    }
    EXPECT_EQ(wrong, 0) << "frame " << i;
  }
  source.reset();
  EXPECT_EQ(camera.exposure(), found);
}

TEST(V4l2Uvc, a_camera_that_is_unplugged_while_streaming_is_told) {
  UvcCamera camera(kWidth, kHeight, pattern());
  auto source = opened(camera);
  ASSERT_TRUE(source);
  ASSERT_TRUE(source->set_exposure(5'000'000));
  ASSERT_TRUE(source->start());
  ASSERT_TRUE(source->next(kPatience));
  camera.unplug();
  tl::expected<Frame, CameraError> frame;
  do {
    frame = source->next(kPatience);
  } while (frame);
  EXPECT_EQ(frame.error().kind, CameraError::Kind::unplugged) << frame.error().message;
  EXPECT_EQ(frame.error().errno_value, ENODEV);
  EXPECT_FALSE(source->set_exposure(6'000'000));
}

}  // namespace
}  // namespace celadon
