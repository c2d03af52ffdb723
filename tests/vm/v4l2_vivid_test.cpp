// V4l2Source against the kernel's vivid driver; runs in the guest, with vivid loaded for /dev/video0 and /dev/video1.
#include <gmock/gmock.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>

#include <cmath>
#include <fstream>
#include <memory>
#include <numeric>
#include <vector>

#include "acquisition/frame.h"
#include "tests/vm/vivid_controls.h"

namespace celadon {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using Kind = CameraError::Kind;

constexpr const char* kDevice = "/dev/video0";
constexpr std::int64_t kSecond = 1'000'000'000;
/// The watchdog of a stream that is alive: emulation is slow, and no test measures time.
constexpr std::int64_t kPatience = 60 * kSecond;

std::unique_ptr<FrameSource> opened(const std::string& options = "?width=640&height=360") {
  auto source = open_frame_source(std::string("v4l2:") + kDevice + options);
  EXPECT_TRUE(source) << source.error().message;
  return source ? std::move(*source) : nullptr;
}

/// Mappings of the device in this process.
int mappings() {
  std::ifstream maps("/proc/self/maps");
  int count = 0;
  for (std::string line; std::getline(maps, line);) count += line.find(kDevice) != std::string::npos;
  return count;
}

/// Luma of the frame's columns, averaged over its lower half (vivid writes text into the upper one).
std::vector<double> columns(const CameraMode& mode, const Frame& frame) {
  const std::size_t step = bytes_per_pixel(mode.format);
  std::vector<double> out(static_cast<std::size_t>(mode.width_px));
  for (std::size_t row = static_cast<std::size_t>(mode.height_px) / 2; row < static_cast<std::size_t>(mode.height_px);
       ++row) {
    for (std::size_t x = 0; x < out.size(); ++x) out[x] += frame.bytes()[row * mode.stride_bytes + x * step];
  }
  return out;
}

double correlation(const std::vector<double>& a, const std::vector<double>& b) {
  const auto n = static_cast<double>(a.size());
  const double mean_a = std::accumulate(a.begin(), a.end(), 0.0) / n,
               mean_b = std::accumulate(b.begin(), b.end(), 0.0) / n;
  double aa = 0, bb = 0, ab = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    aa += (a[i] - mean_a) * (a[i] - mean_a);
    bb += (b[i] - mean_b) * (b[i] - mean_b);
    ab += (a[i] - mean_a) * (b[i] - mean_b);
  }
  return ab / std::sqrt(aa * bb);
}

TEST(V4l2Vivid, streams_grey_and_yuyv_without_gaps_in_place) {
  std::vector<std::vector<double>> pictures;
  for (const char* format : {"GREY", "YUYV"}) {
    auto source = opened(std::string("?width=640&height=360&format=") + format);
    ASSERT_TRUE(source);
    EXPECT_EQ(source->mode().width_px, 640);
    EXPECT_EQ(source->mode().height_px, 360);
    EXPECT_STREQ(to_string(source->mode().format), format);
    EXPECT_EQ(source->mode().identity, "vivid");
    EXPECT_FALSE(source->mode().simulated);
    EXPECT_GT(source->mode().frame_period_ns, 0);
    EXPECT_EQ(mappings(), 0);
    ASSERT_TRUE(source->start());
    EXPECT_GE(mappings(), 2);
    std::uint64_t expected = 0;
    std::int64_t last_stamp = 0;
    for (int i = 0; i < 30; ++i) {
      auto frame = source->next(kPatience);
      ASSERT_TRUE(frame) << frame.error().message;
      if (i == 0) expected = frame->info.sequence;
      // Under a loaded emulator vivid itself may skip: then it must say so.
      expected += frame->info.lost_before;
      // vivid derives its number from rounded jiffies and may give the first one twice; its stamps rise all the same.
      if (i == 1 && frame->info.sequence + 1 == expected) --expected;
      EXPECT_EQ(frame->info.sequence, expected++);
      EXPECT_GT(frame->info.stamp_ns, last_stamp);
      EXPECT_FALSE(frame->info.corrupt);
      last_stamp = frame->info.stamp_ns;
      if (i == 29) pictures.push_back(columns(source->mode(), *frame));
    }
    timespec now{};
    ::clock_gettime(CLOCK_MONOTONIC, &now);
    // vivid stamps a frame with the time at which it ought to end, up to a period ahead.
    EXPECT_LE(last_stamp, now.tv_sec * kSecond + now.tv_nsec + 2 * source->mode().frame_period_ns);
    EXPECT_GT(last_stamp, now.tv_sec * kSecond - 3600 * kSecond);
    source->stop();
    EXPECT_EQ(mappings(), 0);
    ASSERT_TRUE(source->start());  // and again
    ASSERT_TRUE(source->next(kPatience));
  }
  EXPECT_EQ(mappings(), 0);
  EXPECT_GT(correlation(pictures[0], pictures[1]), 0.95);  // full against limited range of luma
}

TEST(V4l2Vivid, grey_is_chosen_unless_another_format_is_given) {
  EXPECT_EQ(opened("")->mode().format, PixelFormat::grey8);
}

TEST(V4l2Vivid, a_larger_stride_of_a_format_before_is_not_kept) {
  opened("?width=1280&height=720&format=YUYV").reset();
  const auto source = opened("?width=640&height=360&format=GREY");
  ASSERT_TRUE(source);
  EXPECT_EQ(source->mode().stride_bytes, 640u);
}

TEST(V4l2Vivid, leases_hold_buffers_back_and_return_them) {
  auto source = opened();
  ASSERT_TRUE(source->start());
  std::vector<Frame> held;
  tl::expected<Frame, CameraError> frame;
  while ((frame = source->next(kPatience))) {
    held.push_back(std::move(*frame));
    ASSERT_LT(held.size(), 64u);
  }
  EXPECT_EQ(frame.error().kind, Kind::busy);
  EXPECT_THAT(frame.error().message, HasSubstr("buffers are lent"));
  for (std::size_t i = 1; i < held.size(); ++i) {
    EXPECT_NE(held[i].bytes().data(), held[i - 1].bytes().data());
    EXPECT_GT(held[i].info.stamp_ns, held[i - 1].info.stamp_ns);
  }
  held.erase(held.begin());
  const auto next = source->next(kPatience);
  ASSERT_TRUE(next) << next.error().message;
  held.clear();
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(source->next(kPatience));
}

TEST(V4l2Vivid, dropped_buffers_are_counted_as_gaps) {
  const VividControls vivid(kDevice);
  auto source = opened();
  ASSERT_TRUE(source->start());
  ASSERT_TRUE(source->next(kPatience));
  vivid.set("Percentage of Dropped Buffers", 60);
  std::uint64_t lost = 0, last = 0;
  for (int i = 0; i < 40; ++i) {
    auto frame = source->next(kPatience);
    ASSERT_TRUE(frame) << frame.error().message;
    lost += frame->info.lost_before;
    if (i > 0 && !(i == 1 && frame->info.sequence == last)) {
      EXPECT_EQ(frame->info.sequence, last + 1 + frame->info.lost_before);
    }
    last = frame->info.sequence;
  }
  vivid.set("Percentage of Dropped Buffers", 0);
  EXPECT_GT(lost, 10u);
}

TEST(V4l2Vivid, a_stalled_stream_is_told_by_the_watchdog_and_recovers) {
  const VividControls vivid(kDevice);
  auto source = opened();
  ASSERT_TRUE(source->start());
  ASSERT_TRUE(source->next(kPatience));
  vivid.set("Percentage of Dropped Buffers", 100);
  tl::expected<Frame, CameraError> frame;
  do {
    frame = source->next(kSecond);
  } while (frame);  // those that were ready before
  EXPECT_EQ(frame.error().kind, Kind::timed_out);
  EXPECT_THAT(frame.error().message, AllOf(HasSubstr(kDevice), HasSubstr("1000 ms"), HasSubstr("stalled")));
  vivid.set("Percentage of Dropped Buffers", 0);
  frame = source->next(kPatience);
  EXPECT_TRUE(frame) << frame.error().message;
}

TEST(V4l2Vivid, a_buffer_with_an_error_is_corrupt_and_the_next_is_good) {
  const VividControls vivid(kDevice);
  auto source = opened();
  ASSERT_TRUE(source->start());
  ASSERT_TRUE(source->next(kPatience));
  vivid.set("Inject V4L2_BUF_FLAG_ERROR");
  int corrupt = 0;
  for (int i = 0; i < 20; ++i) {
    auto frame = source->next(kPatience);
    ASSERT_TRUE(frame);
    corrupt += frame->info.corrupt;
  }
  EXPECT_EQ(corrupt, 1);
}

TEST(V4l2Vivid, a_refused_stream_is_told_and_started_again) {
  const VividControls vivid(kDevice);
  auto source = opened();
  for (const char* fault : {"Inject VIDIOC_REQBUFS Error", "Inject VIDIOC_STREAMON Error"}) {
    vivid.set(fault);
    const auto refused = source->start();
    ASSERT_FALSE(refused) << fault;
    EXPECT_THAT(refused.error().message, AllOf(HasSubstr(kDevice), HasSubstr("errno 22")));
    EXPECT_EQ(mappings(), 0);
    ASSERT_TRUE(source->start()) << fault;
    EXPECT_TRUE(source->next(kPatience));
    source->stop();
  }
}

TEST(V4l2Vivid, a_fatal_error_of_the_queue_is_told_and_a_restart_helps) {
  const VividControls vivid(kDevice);
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

TEST(V4l2Vivid, the_event_of_the_stamp_is_told) {
  const VividControls vivid(kDevice);
  for (const auto& [value, point] :
       {std::pair{0, StampPoint::end_of_frame}, std::pair{1, StampPoint::start_of_exposure}}) {
    vivid.set("Timestamp Source", value);
    auto source = opened();
    ASSERT_TRUE(source->start());
    EXPECT_TRUE(source->next(kPatience));
    EXPECT_EQ(source->mode().stamp_point, point);
  }
  vivid.set("Timestamp Source", 0);
}

TEST(V4l2Vivid, a_second_user_of_the_camera_is_told_that_it_is_busy) {
  auto first = opened();
  auto second = opened();  // opened before the first streams
  ASSERT_TRUE(first->start());
  const auto streaming = second->start();
  ASSERT_FALSE(streaming);
  EXPECT_EQ(streaming.error().kind, Kind::busy);
  EXPECT_THAT(streaming.error().message, AllOf(HasSubstr("errno 16"), HasSubstr("another program")));
  const auto third = open_frame_source(std::string("v4l2:") + kDevice + "?width=1280&height=720");
  ASSERT_FALSE(third);
  EXPECT_EQ(third.error().kind, Kind::busy);
}

TEST(V4l2Vivid, sizes_and_formats_that_it_lacks_are_named) {
  const auto odd = open_frame_source(std::string("v4l2:") + kDevice + "?width=641&height=361");
  ASSERT_FALSE(odd);
  EXPECT_EQ(odd.error().kind, Kind::unsupported);
  EXPECT_THAT(odd.error().message, AllOf(HasSubstr("641 x 361"), HasSubstr("instead")));
}

TEST(V4l2Vivid, an_exposure_that_it_lacks_is_named_by_its_control) {
  auto source = opened();
  const auto set = source->set_exposure(5'000'000);
  ASSERT_FALSE(set);
  EXPECT_EQ(set.error().kind, Kind::unsupported);
  EXPECT_THAT(set.error().message, HasSubstr("exposure_time_absolute"));
}

TEST(V4l2Vivid, a_user_without_rights_is_told_the_group) {
  ASSERT_EQ(::chmod(kDevice, 0660), 0);
  const pid_t child = ::fork();
  if (child == 0) {
    if (::setgroups(0, nullptr) != 0 || ::setgid(65534) != 0 || ::setuid(65534) != 0) ::_exit(2);
    const auto source = open_frame_source(std::string("v4l2:") + kDevice);
    ::_exit(!source && source.error().kind == Kind::permission && source.error().errno_value == EACCES &&
                    source.error().message.find("group video") != std::string::npos
                ? 0
                : 1);
  }
  int status = -1;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
}

TEST(V4l2VividDeathTest, a_frame_that_outlives_its_source_ends_the_program) {
  EXPECT_DEATH(
      {
        auto source = opened();
        static_cast<void>(source->start());
        auto frame = source->next(kPatience);
        source.reset();
      },
      "1 frames lent");
}

// Last: the device stays away.
TEST(V4l2VividUnplugged, a_camera_that_is_unplugged_while_streaming_is_told) {
  constexpr const char* kOther = "/dev/video1";
  auto source = open_frame_source(std::string("v4l2:") + kOther + "?width=640&height=360");
  ASSERT_TRUE(source) << source.error().message;
  ASSERT_TRUE((*source)->start());
  auto held = (*source)->next(kPatience);
  ASSERT_TRUE(held);
  const std::uint8_t seen = held->bytes()[0];
  VividControls(kOther).set("Disconnect");
  tl::expected<Frame, CameraError> frame;
  do {
    frame = (*source)->next(kPatience);
  } while (frame);
  EXPECT_EQ(frame.error().kind, Kind::unplugged);
  EXPECT_EQ(frame.error().errno_value, ENODEV);
  EXPECT_THAT(frame.error().message, AllOf(HasSubstr(kOther), HasSubstr("errno 19"), HasSubstr("connect the camera")));
  // The lease's memory stays, and giving it back is harmless.
  EXPECT_EQ(held->bytes()[0], seen);
  held->release();
  (*source)->stop();
  EXPECT_FALSE((*source)->start());
}

}  // namespace
}  // namespace celadon
