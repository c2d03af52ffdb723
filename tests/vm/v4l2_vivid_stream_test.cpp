// V4L2Source's streams from the kernel's vivid driver, through the single-planar and the multi-planar interface; runs
// in the guest, with vivid loaded for /dev/video0 and 1 (single-planar), 2 and 3 (multi-planar).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <ctime>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "acquisition/frame.h"
#include "tests/vm/vivid_camera.h"
#include "tests/vm/vivid_controls.h"

namespace celadon {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using Kind = CameraError::Kind;

std::int64_t monotonic_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kSecond + now.tv_nsec;
}

struct Interface {
  const char *name, *device, *to_unplug;
};

class V4l2VividStream : public testing::TestWithParam<Interface> {
 protected:
  const std::string device_ = GetParam().device;
  const bool multi_planar_ = GetParam().name == std::string("multi_planar");

  std::unique_ptr<FrameSource> opened(const std::string& options = "?width=640&height=360") const {
    return open_vivid(device_, options);
  }
};

const auto kInterfaces = testing::Values(Interface{"single_planar", "/dev/video0", "/dev/video1"},
                                         Interface{"multi_planar", "/dev/video2", "/dev/video3"});
const auto name_of = [](const testing::TestParamInfo<Interface>& info) { return std::string(info.param.name); };

INSTANTIATE_TEST_SUITE_P(Vivid, V4l2VividStream, kInterfaces, name_of);

TEST_P(V4l2VividStream, streams_grey_and_yuyv_in_place_and_says_what_the_kernel_said) {
  for (const char* format : {"GREY", "YUYV"}) {
    auto source = opened(std::string("?width=640&height=360&format=") + format);
    ASSERT_TRUE(source);
    EXPECT_EQ(source->mode().width_px, 640);
    EXPECT_EQ(source->mode().height_px, 360);
    EXPECT_STREQ(to_string(source->mode().format), format);
    EXPECT_EQ(source->mode().identity, "vivid");
    EXPECT_FALSE(source->mode().simulated);
    EXPECT_GT(source->mode().frame_period_ns, 0);
    EXPECT_EQ(mappings_of(device_), 0);
    const std::int64_t started_ns = monotonic_ns();
    ASSERT_TRUE(source->start());
    EXPECT_GE(mappings_of(device_), 2);
    FrameCheck told(device_);
    for (int i = 0; i < 30; ++i) {
      auto frame = source->next(kPatience);
      ASSERT_TRUE(frame) << frame.error().message;
      told.check(*frame);
      EXPECT_FALSE(frame->info.corrupt);
      // vivid stamps the time at which it began to draw and 0.9 periods more, for the end of the frame.
      const std::int64_t drawn_ns = frame->info.stamp_ns - source->mode().frame_period_ns * 9 / 10;
      EXPECT_GE(drawn_ns + 1000, started_ns);  // its unit is 1 us
      EXPECT_LE(drawn_ns, monotonic_ns());
      // Full range by the weights of Rec. 709, limited range by those of Rec. 601; vivid truncates twice.
      const bool grey = source->mode().format == PixelFormat::grey8;
      const double r = grey ? 0.2126 : 0.299, b = grey ? 0.0722 : 0.114, g = 1 - r - b;
      const double black = grey ? 0 : 16, white = grey ? 255 : 235;
      const std::array<double, 8> weights{1, r + g, g + b, g, r + b, r, b, 0};
      const std::array<int, 8> seen = bars(source->mode(), *frame);
      for (std::size_t k = 0; k < seen.size(); ++k) {
        EXPECT_NEAR(seen[k], black + (white - black) * 0.75 * weights[k], 2) << format << ", bar " << k;
      }
    }
    source->stop();
    EXPECT_EQ(mappings_of(device_), 0);
    ASSERT_TRUE(source->start());  // and again
    ASSERT_TRUE(source->next(kPatience));
  }
  EXPECT_EQ(mappings_of(device_), 0);
}

/// Grey level of a bar for the shares of red, green and blue in it.
using GreyOf = double (*)(double r, double g, double b);

TEST_P(V4l2VividStream, formats_that_are_decoded_become_grey_and_planes_of_luma_are_read_in_place) {
  const GreyOf limited = [](double r, double g, double b) {
    return 16 + 219 * 0.75 * (0.299 * r + 0.587 * g + 0.114 * b);
  };
  const GreyOf full = [](double r, double g, double b) { return 255 * 0.75 * (0.2126 * r + 0.7152 * g + 0.0722 * b); };
  const GreyOf mosaic = [](double r, double g, double b) { return 255 * 0.75 * (r + 2 * g + b) / 4; };
  std::vector<std::pair<std::string, GreyOf>> formats = {{"NV12", limited}, {"UYVY", limited}, {"Y10", full},
                                                         {"Y12", full},     {"Y16", full},     {"BA81", mosaic},
                                                         {"GBRG", mosaic},  {"GRBG", mosaic},  {"RGGB", mosaic}};
  std::set<std::string> in_place = {"NV12"};
  if (multi_planar_) {
    for (const char* luma_alone : {"NM12", "YM12", "NM16"}) {
      formats.emplace_back(luma_alone, limited);
      in_place.insert(luma_alone);
    }
  }
  for (const auto& [format, grey_of] : formats) {
    auto source = opened("?width=640&height=360&format=" + format);
    ASSERT_TRUE(source) << format;
    EXPECT_EQ(source->mode().format, PixelFormat::grey8) << format;
    EXPECT_EQ(source->mode().saturated_level, grey_of == limited ? 235 : 250) << format;
    ASSERT_TRUE(source->start());
    std::vector<Frame> held;  // no picture may be written over while it is lent
    for (int i = 0; i < 3; ++i) {
      auto frame = source->next(kPatience);
      ASSERT_TRUE(frame) << frame.error().message;
      EXPECT_FALSE(frame->info.corrupt) << format;
      // vivid puts the luma of this one behind a header.
      EXPECT_EQ(dequeued_buffers().back().data_offset > 0, format == "NM16") << format;
      EXPECT_EQ(is_in_place(device_, *frame), in_place.contains(format)) << format;
      held.push_back(std::move(*frame));
    }
    EXPECT_NE(held[0].bytes().data(), held[1].bytes().data());
    for (const Frame& frame : held) {
      const std::array<int, 8> seen = bars(source->mode(), frame);
      for (unsigned k = 0; k < 8; ++k) {  // white, yellow, cyan, green, magenta, red, blue, black
        const double r = k % 4 < 2, g = k < 4, b = k % 2 == 0;
        EXPECT_NEAR(seen[k], grey_of(r, g, b), 2.5) << format << ", bar " << k;
      }
    }
  }
}

TEST_P(V4l2VividStream, leases_hold_buffers_back_and_return_them) {
  auto source = opened();
  ASSERT_TRUE(source->start());
  std::vector<Frame> held;
  FrameCheck told(device_);
  tl::expected<Frame, CameraError> frame;
  while ((frame = source->next(kPatience))) {
    told.check(*frame);
    held.push_back(std::move(*frame));
    ASSERT_LT(held.size(), 64u);
  }
  EXPECT_EQ(frame.error().kind, Kind::busy);
  EXPECT_THAT(frame.error().message, HasSubstr("buffers are lent"));
  std::vector<const std::uint8_t*> places;
  for (const Frame& f : held) places.push_back(f.bytes().data());
  std::sort(places.begin(), places.end());
  EXPECT_EQ(std::adjacent_find(places.begin(), places.end()), places.end());
  const std::uint8_t* given_back = held.front().bytes().data();
  held.erase(held.begin());
  const auto next = source->next(kPatience);
  ASSERT_TRUE(next) << next.error().message;
  told.check(*next);
  EXPECT_EQ(next->bytes().data(), given_back);  // the only buffer that the driver had
  held.clear();
  for (int i = 0; i < 20; ++i) {
    frame = source->next(kPatience);
    ASSERT_TRUE(frame);
    told.check(*frame);
  }
}

TEST_P(V4l2VividStream, dropped_buffers_are_counted_as_gaps) {
  const VividControls vivid(device_);
  auto source = opened();
  ASSERT_TRUE(source->start());
  FrameCheck told(device_);
  auto frame = source->next(kPatience);
  ASSERT_TRUE(frame);
  told.check(*frame);
  vivid.set("Percentage of Dropped Buffers", 60);
  std::uint64_t lost = 0;
  for (int i = 0; i < 40; ++i) {
    frame = source->next(kPatience);
    ASSERT_TRUE(frame) << frame.error().message;
    told.check(*frame);
    lost += frame->info.lost_before;
  }
  vivid.set("Percentage of Dropped Buffers", 0);
  EXPECT_GT(lost, 10u);
}

TEST_P(V4l2VividStream, a_stalled_stream_is_told_by_the_watchdog_and_recovers) {
  const VividControls vivid(device_);
  auto source = opened();
  ASSERT_TRUE(source->start());
  ASSERT_TRUE(source->next(kPatience));
  vivid.set("Percentage of Dropped Buffers", 100);
  tl::expected<Frame, CameraError> frame;
  do {
    frame = source->next(kSecond);
  } while (frame);  // those that were ready before
  EXPECT_EQ(frame.error().kind, Kind::timed_out);
  EXPECT_THAT(frame.error().message, AllOf(HasSubstr(device_), HasSubstr("1000 ms"), HasSubstr("stalled")));
  vivid.set("Percentage of Dropped Buffers", 0);
  frame = source->next(kPatience);
  EXPECT_TRUE(frame) << frame.error().message;
}

TEST_P(V4l2VividStream, a_buffer_with_an_error_is_corrupt_and_the_next_is_good) {
  const VividControls vivid(device_);
  auto source = opened();
  ASSERT_TRUE(source->start());
  ASSERT_TRUE(source->next(kPatience));
  vivid.set("Inject V4L2_BUF_FLAG_ERROR");
  FrameCheck told(device_);
  int corrupt = 0;
  for (int i = 0; i < 20; ++i) {
    auto frame = source->next(kPatience);
    ASSERT_TRUE(frame);
    told.check(*frame);
    corrupt += frame->info.corrupt;
  }
  EXPECT_EQ(corrupt, 1);
}

TEST_P(V4l2VividStream, a_refused_stream_is_told_and_started_again) {
  const VividControls vivid(device_);
  auto source = opened();
  vivid.set("Inject VIDIOC_STREAMON Error");
  const auto refused = source->start();
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, AllOf(HasSubstr(device_), HasSubstr("errno 22")));
  EXPECT_EQ(mappings_of(device_), 0);
  ASSERT_TRUE(source->start());
  EXPECT_TRUE(source->next(kPatience));
  source->stop();
}

// The driver refuses to map its memory, once: it is given some of the program's.
TEST_P(V4l2VividStream, streams_into_the_programs_own_memory_where_the_driver_maps_none) {
  const VividControls vivid(device_);
  auto source = opened("?width=640&height=360&format=GREY");
  for (const bool own : {true, false}) {
    if (own) vivid.set("Inject VIDIOC_REQBUFS Error");
    ASSERT_TRUE(source->start());
    for (int i = 0; i < 20; ++i) {
      const auto frame = source->next(kPatience);
      ASSERT_TRUE(frame) << frame.error().message;
      EXPECT_EQ(mappings_of(device_) == 0, own);
      EXPECT_NEAR(bars(source->mode(), *frame)[0], 255 * 0.75, 2);
    }
    source->stop();
  }
}

TEST_P(V4l2VividStream, a_fatal_error_of_the_queue_is_told_and_a_restart_helps) {
  const VividControls vivid(device_);
  auto source = opened();
  ASSERT_TRUE(source->start());
  ASSERT_TRUE(source->next(kPatience));
  vivid.set("Inject Fatal Streaming Error");
  tl::expected<Frame, CameraError> frame;
  do {
    frame = source->next(kPatience);
  } while (frame);
  EXPECT_EQ(frame.error().errno_value, EIO);
  EXPECT_EQ(frame.error().kind, Kind::system);
  EXPECT_THAT(frame.error().message, HasSubstr("stop and start"));
  source->stop();
  ASSERT_TRUE(source->start());
  EXPECT_TRUE(source->next(kPatience));
}

// Last: the device stays away.
using V4l2VividUnplugged = V4l2VividStream;
INSTANTIATE_TEST_SUITE_P(Vivid, V4l2VividUnplugged, kInterfaces, name_of);

TEST_P(V4l2VividUnplugged, a_camera_that_is_unplugged_while_streaming_is_told) {
  const std::string device = GetParam().to_unplug;
  auto source = open_frame_source("v4l2:" + device + "?width=640&height=360");
  ASSERT_TRUE(source) << source.error().message;
  ASSERT_TRUE((*source)->start());
  auto held = (*source)->next(kPatience);
  ASSERT_TRUE(held);
  const std::uint8_t seen = held->bytes()[0];
  VividControls(device).set("Disconnect");
  tl::expected<Frame, CameraError> frame;
  do {
    frame = (*source)->next(kPatience);
  } while (frame);
  EXPECT_EQ(frame.error().kind, Kind::unplugged);
  EXPECT_EQ(frame.error().errno_value, ENODEV);
  EXPECT_THAT(frame.error().message, AllOf(HasSubstr(device), HasSubstr("errno 19"), HasSubstr("connect the camera")));
  // The lease's memory stays, and giving it back is harmless.
  EXPECT_EQ(held->bytes()[0], seen);
  held->release();
  (*source)->stop();
  EXPECT_FALSE((*source)->start());
}

}  // namespace
}  // namespace celadon
