// V4L2Source against the kernel's uvcvideo driver with the simulator's USB camera and a sensor of the test's own; runs
// in the guest.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <cerrno>
#include <condition_variable>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <set>
#include <string>

#include "acquisition/frame.h"
#include "acquisition/v4l2_devices.h"
#include "daemon/device_news.h"
#include "sim/pacer.h"
#include "sim/uvc_camera.h"
#include "tests/sim/pattern_sensor.h"
#include "tests/vm/plugged_usb.h"

namespace celadon {
namespace {

using Controls = sim::UvcCamera::Controls;
constexpr std::int64_t kPatience = 60'000'000'000;  // emulation is slow, and no test measures time
constexpr int kWidth = 320, kHeight = 240;
/// The capture node; uvcvideo makes another for metadata.
constexpr const char* kNode = "/dev/video0";

/// Begins a picture every 20 ms, as sensors do: of pictures that come without a pause the driver, which copies them in
/// several threads, may finish the second before the first.
class PacedSensor final : public sim::PatternSensor {
 public:
  using PatternSensor::PatternSensor;
  bool begin_picture() override {
    const std::int64_t now_ns = sim::monotonic_ns();
    if (now_ns < next_ns_) return false;
    next_ns_ = now_ns + 20'000'000;
    return true;
  }

 private:
  std::int64_t next_ns_ = 0;
};

/// Sees another pattern in every frame.
class Camera {
 public:
  /// @param node  that its capture node will have
  explicit Camera(const std::string& node = kNode) : usb_(device_, node) {}
  Controls controls() const {
    return usb_.locked([this] { return camera_.controls(); });
  }
  void unplug() { usb_.unplug(); }

 private:
  PacedSensor sensor_{kWidth, kHeight};
  sim::UvcCamera camera_{sensor_, 15'600'000};
  sim::UsbDevice device_{{0x1209, 0x0001, "Celadon", "Test Camera", "CAM001"}, {&camera_}};
  PluggedUsb usb_;
};

std::uint8_t pixel(std::uint8_t first, int x, int y) {
  return static_cast<std::uint8_t>(first + sim::PatternSensor::level(0, x, y));
}

std::unique_ptr<FrameSource> opened(const std::string& options = "") {
  auto source = open_frame_source(std::string("v4l2:") + kNode + options);
  EXPECT_TRUE(source) << source.error().message;
  return source ? std::move(*source) : nullptr;
}

TEST(V4l2Uvc, exposure_reaches_the_camera_and_is_put_back) {
  const Camera camera;
  const Controls found = camera.controls();
  auto source = opened();
  ASSERT_TRUE(source);
  EXPECT_EQ(source->mode().exposure_ns, 0) << "the automatic sets it";
  EXPECT_EQ(source->mode().identity, "Test Camera CAM001");
  const auto set = source->set_exposure(5'000'000);
  ASSERT_TRUE(set) << set.error().message;
  EXPECT_EQ(*set, 5'000'000);
  EXPECT_EQ(camera.controls(), (Controls{sim::UvcCamera::kManual, 50, sim::UvcCamera::kUnitGain}));
  EXPECT_EQ(*source->set_exposure(1), 100'000);
  EXPECT_EQ(*source->set_exposure(10'000'000'000), 204'700'000);
  source.reset();
  EXPECT_EQ(camera.controls(), found);
}

TEST(V4l2Uvc, frames_come_whole_and_exposure_is_put_back_after_streaming) {
  const Camera camera;
  const Controls found = camera.controls();
  auto source = opened();
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
  EXPECT_EQ(camera.controls(), found);
}

TEST(V4l2Uvc, gain_set_through_the_driver_makes_brighter_pictures) {
  const Camera camera;
  auto source = opened("?format=YUYV");
  ASSERT_TRUE(source);
  EXPECT_EQ(source->mode().format, PixelFormat::yuyv);
  const sim::FileDescriptor node(::open(kNode, O_RDWR | O_CLOEXEC));
  v4l2_control gain{V4L2_CID_GAIN, 2 * sim::UvcCamera::kUnitGain};
  ASSERT_EQ(::ioctl(node.get(), VIDIOC_S_CTRL, &gain), 0);
  ASSERT_TRUE(source->start());
  const auto frame = source->next(kPatience);
  ASSERT_TRUE(frame) << frame.error().message;
  // Levels that are doubled are even, or saturated.
  int wrong = 0, bright = 0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(kWidth * kHeight); ++i) {
    const std::uint8_t luma = frame->bytes()[2 * i];
    wrong += luma % 2 != 0 && luma != 255;
    bright += luma == 255;
    wrong += frame->bytes()[2 * i + 1] != 128;
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_NEAR(bright, 0.5 * kWidth * kHeight, 0.05 * kWidth * kHeight);
}

TEST(V4l2Uvc, mjpeg_pictures_decode_to_the_pattern) {
  const Camera camera;
  auto source = opened("?format=MJPG");
  ASSERT_TRUE(source);
  EXPECT_EQ(source->mode().format, PixelFormat::grey8);
  ASSERT_TRUE(source->start());
  for (int i = 0; i < 3; ++i) {
    const auto frame = source->next(kPatience);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_FALSE(frame->info.corrupt);
    // Patterns of later frames are brighter by a number that the compressed picture blurs: the best of all.
    double least = 1e9;
    for (int first = 0; first < 256; ++first) {
      double off = 0;
      for (int y = 0; y < kHeight; y += 4) {
        for (int x = 0; x < kWidth; x += 4) {
          const int grey = frame->bytes()[static_cast<std::size_t>(y * kWidth + x)];
          off += std::abs(grey - pixel(static_cast<std::uint8_t>(first), x, y));
        }
      }
      least = std::min(least, off / ((kWidth / 4) * (kHeight / 4)));
    }
    EXPECT_LT(least, 6) << "mean difference in levels, of a pattern that wraps";
  }
}

// A program that holds the node of the camera that is gone keeps its number.
TEST(V4l2Uvc, a_camera_that_comes_back_under_another_number_is_found_by_its_serial_number) {
  std::unique_ptr<FrameSource> held;
  {
    const Camera camera;
    held = opened();
    ASSERT_TRUE(held);
    EXPECT_TRUE(held->check_present());
  }
  const auto gone = held->check_present();
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, CameraError::Kind::unplugged) << gone.error().message;
  const Camera back("/dev/video1");
  EXPECT_FALSE(open_frame_source(std::string("v4l2:") + kNode));
  auto source = open_frame_source("v4l2:serial=CAM001?format=GREY");
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ((*source)->mode().identity, "Test Camera CAM001");
  ASSERT_TRUE((*source)->start());
  const auto frame = (*source)->next(kPatience);
  EXPECT_TRUE(frame) << frame.error().message;
  // Its node for metadata captures no pictures.
  const auto listed = list_v4l2_devices();
  ASSERT_EQ(listed.size(), 1u);
  EXPECT_EQ(address_of(listed[0], listed), "v4l2:serial=CAM001");
  EXPECT_FALSE(open_frame_source("v4l2:serial=CAM002"));
}

// The guest has no udev.
TEST(V4l2Uvc, a_camera_that_comes_or_goes_is_told_by_the_kernel) {
  std::mutex mutex;
  std::condition_variable changed;
  std::set<std::string> told;
  const DeviceNews news([&](const std::string& device) {
    const std::lock_guard lock(mutex);
    told.insert(device);
    changed.notify_all();
  });
  EXPECT_EQ(news.source(), DeviceNews::Source::kernel);
  const auto wait_for_news = [&] {
    std::unique_lock lock(mutex);
    changed.wait(lock, [&] { return told.contains("video0"); });
    told.clear();
  };
  {
    const Camera camera;
    wait_for_news();
  }
  wait_for_news();
}

TEST(V4l2Uvc, a_camera_that_is_unplugged_while_streaming_is_told) {
  Camera camera;
  auto source = opened();
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
