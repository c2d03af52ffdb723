// V4l2Source against the kernel's vivid driver; runs in the guest, with vivid loaded for /dev/video0 and /dev/video1.
#include <gmock/gmock.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>

#include <algorithm>
#include <array>
#include <ctime>
#include <fstream>
#include <map>
#include <memory>
#include <vector>

#include "acquisition/frame.h"
#include "acquisition/v4l2_address.h"
#include "acquisition/v4l2_devices.h"
#include "tests/vm/kernel_record.h"
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

std::int64_t monotonic_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kSecond + now.tv_nsec;
}

/// Says of each frame what the kernel said of its buffer, number by number. vivid counts the frames that ought to have
/// been by rounding the time since the start to whole periods, and waits from before it drew the last picture: one that
/// took longer to draw than half a period, as happens under emulation, brings the same number twice
/// (vivid-kthread-cap.c; seen at any place of a stream by a program that only dequeues). The source has to tell just
/// that.
class FrameCheck {
 public:
  void check(const Frame& frame) {
    ASSERT_FALSE(dequeued_buffers().empty());
    const v4l2_buffer said = dequeued_buffers().back();
    EXPECT_EQ(frame.info.sequence, said.sequence);
    EXPECT_EQ(frame.info.stamp_ns, said.timestamp.tv_sec * kSecond + said.timestamp.tv_usec * 1000);
    EXPECT_EQ(frame.info.corrupt, (said.flags & V4L2_BUF_FLAG_ERROR) != 0);
    // The frame is the driver's own memory, of this buffer and no other.
    EXPECT_TRUE(is_mapping(kDevice, frame.bytes().data()));
    const std::uint8_t*& place = places_[said.index];
    if (place == nullptr) place = frame.bytes().data();
    EXPECT_EQ(frame.bytes().data(), place);
    EXPECT_EQ(std::count_if(places_.begin(), places_.end(), [&](const auto& p) { return p.second == place; }), 1);
    const bool follows = has_last_ && said.sequence > last_.sequence;
    EXPECT_EQ(frame.info.lost_before, follows ? said.sequence - last_.sequence - 1 : 0);
    if (has_last_) {
      EXPECT_GE(frame.info.sequence, last_.sequence);
      EXPECT_GT(frame.info.stamp_ns, last_stamp_ns_);
    }
    last_ = said;
    last_stamp_ns_ = frame.info.stamp_ns;
    has_last_ = true;
  }

 private:
  v4l2_buffer last_{};
  std::int64_t last_stamp_ns_ = 0;
  bool has_last_ = false;
  std::map<std::uint32_t, const std::uint8_t*> places_;
};

/// Luma in the middle of each of the eight bars (white, yellow, cyan, green, magenta, red, blue, black of 75 %), below
/// the text that vivid writes.
std::array<int, 8> bars(const CameraMode& mode, const Frame& frame) {
  std::array<int, 8> out{};
  const auto row = static_cast<std::size_t>(mode.height_px) * 3 / 4;
  for (std::size_t bar = 0; bar < out.size(); ++bar) {
    const std::size_t x = (2 * bar + 1) * static_cast<std::size_t>(mode.width_px) / (2 * out.size());
    out[bar] = frame.bytes()[row * mode.stride_bytes + x * bytes_per_pixel(mode.format)];
  }
  return out;
}

TEST(V4l2Vivid, streams_grey_and_yuyv_in_place_and_says_what_the_kernel_said) {
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
    const std::int64_t started_ns = monotonic_ns();
    ASSERT_TRUE(source->start());
    EXPECT_GE(mappings(), 2);
    FrameCheck told;
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
    EXPECT_EQ(mappings(), 0);
    ASSERT_TRUE(source->start());  // and again
    ASSERT_TRUE(source->next(kPatience));
  }
  EXPECT_EQ(mappings(), 0);
}

/// Grey level of a bar for the shares of red, green and blue in it.
using GreyOf = double (*)(double r, double g, double b);

TEST(V4l2Vivid, formats_that_are_decoded_become_grey_and_nv12_is_read_in_place) {
  const GreyOf limited = [](double r, double g, double b) {
    return 16 + 219 * 0.75 * (0.299 * r + 0.587 * g + 0.114 * b);
  };
  const GreyOf full = [](double r, double g, double b) { return 255 * 0.75 * (0.2126 * r + 0.7152 * g + 0.0722 * b); };
  const GreyOf mosaic = [](double r, double g, double b) { return 255 * 0.75 * (r + 2 * g + b) / 4; };
  const std::pair<const char*, GreyOf> formats[] = {{"NV12", limited}, {"UYVY", limited}, {"Y10", full},
                                                    {"Y12", full},     {"Y16", full},     {"BA81", mosaic},
                                                    {"GBRG", mosaic},  {"GRBG", mosaic},  {"RGGB", mosaic}};
  for (const auto& [format, grey_of] : formats) {
    auto source = opened(std::string("?width=640&height=360&format=") + format);
    ASSERT_TRUE(source) << format;
    EXPECT_EQ(source->mode().format, PixelFormat::grey8) << format;
    EXPECT_EQ(source->mode().saturated_level, grey_of == limited ? 235 : 250) << format;
    ASSERT_TRUE(source->start());
    std::vector<Frame> held;  // no picture may be written over while it is lent
    for (int i = 0; i < 3; ++i) {
      auto frame = source->next(kPatience);
      ASSERT_TRUE(frame) << frame.error().message;
      EXPECT_FALSE(frame->info.corrupt) << format;
      EXPECT_EQ(is_mapping(kDevice, frame->bytes().data()), std::string(format) == "NV12") << format;
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
  FrameCheck told;
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

TEST(V4l2Vivid, dropped_buffers_are_counted_as_gaps) {
  const VividControls vivid(kDevice);
  auto source = opened();
  ASSERT_TRUE(source->start());
  FrameCheck told;
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
  FrameCheck told;
  int corrupt = 0;
  for (int i = 0; i < 20; ++i) {
    auto frame = source->next(kPatience);
    ASSERT_TRUE(frame);
    told.check(*frame);
    corrupt += frame->info.corrupt;
  }
  EXPECT_EQ(corrupt, 1);
}

TEST(V4l2Vivid, a_refused_stream_is_told_and_started_again) {
  const VividControls vivid(kDevice);
  auto source = opened();
  vivid.set("Inject VIDIOC_STREAMON Error");
  const auto refused = source->start();
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, AllOf(HasSubstr(kDevice), HasSubstr("errno 22")));
  EXPECT_EQ(mappings(), 0);
  ASSERT_TRUE(source->start());
  EXPECT_TRUE(source->next(kPatience));
  source->stop();
}

// The driver refuses to map its memory, once: it is given some of the program's.
TEST(V4l2Vivid, streams_into_the_programs_own_memory_where_the_driver_maps_none) {
  const VividControls vivid(kDevice);
  auto source = opened("?width=640&height=360&format=GREY");
  for (const bool own : {true, false}) {
    if (own) vivid.set("Inject VIDIOC_REQBUFS Error");
    ASSERT_TRUE(source->start());
    for (int i = 0; i < 20; ++i) {
      const auto frame = source->next(kPatience);
      ASSERT_TRUE(frame) << frame.error().message;
      EXPECT_EQ(mappings() == 0, own);
      EXPECT_NEAR(bars(source->mode(), *frame)[0], 255 * 0.75, 2);
    }
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

// What the list says of a control follows what another hand sets; formats are those that the driver takes.
TEST(V4l2Vivid, the_list_of_cameras_shows_what_they_offer) {
  const auto find = [](const V4l2Device& device, const std::string& name) -> V4l2Control {
    for (const V4l2Control& control : device.controls)
      if (control.name == name) return control;
    ADD_FAILURE() << "no control " << name;
    return {};
  };
  const auto devices = list_v4l2_devices();
  ASSERT_EQ(devices.size(), 2u);
  EXPECT_EQ(devices[0].path, kDevice);
  EXPECT_EQ(devices[0].driver, "vivid");
  EXPECT_EQ(devices[0].problem, "");
  const V4l2Format* const preferred = preferred_format(devices[0]);
  ASSERT_NE(preferred, nullptr);
  EXPECT_EQ(fourcc_text(preferred->fourcc), "GREY");
  bool listed = false;
  for (const V4l2Size& size : preferred->sizes) {
    if (size.width_px != 640 || size.height_px != 360) continue;
    listed = true;
    EXPECT_FALSE(size.frames_per_second.empty());
    EXPECT_TRUE(std::is_sorted(size.frames_per_second.rbegin(), size.frames_per_second.rend()));
  }
  EXPECT_TRUE(listed);
  const auto unusable = std::count_if(devices[0].formats.begin(), devices[0].formats.end(),
                                      [](const V4l2Format& format) { return !format.usable; });
  EXPECT_GT(unusable, 0);
  const V4l2Control brightness = find(devices[0], "Brightness");
  EXPECT_EQ(brightness.minimum, 0);
  EXPECT_EQ(brightness.maximum, 255);
  VividControls(kDevice).set("Brightness", 77);
  EXPECT_EQ(find(list_v4l2_devices()[0], "Brightness").value, 77);
  VividControls(kDevice).set("Brightness", static_cast<int>(brightness.standard));
  EXPECT_THAT(find(devices[0], "Test Pattern").menu, testing::Contains("75% Colorbar"));
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
