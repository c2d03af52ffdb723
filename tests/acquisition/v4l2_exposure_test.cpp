// V4L2Source's exposure and controls against a camera behind an ioctl() of our own. Everything from open() to close()
// is the real source.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cerrno>
#include <map>
#include <string>
#include <vector>

#include "acquisition/monotonic_clock.h"
#include "tests/acquisition/fake_v4l2_camera.h"

namespace celadon {
namespace {

using testing::HasSubstr;
using Kind = CameraError::Kind;

constexpr std::uint32_t kTime = V4L2_CID_EXPOSURE_ABSOLUTE, kAuto = V4L2_CID_EXPOSURE_AUTO;

using Controls = std::map<std::uint32_t, std::int32_t>;
const Controls kFound = {{kAuto, V4L2_EXPOSURE_APERTURE_PRIORITY}, {kTime, 156}};

TEST(V4l2Exposure, is_set_in_the_units_of_the_camera_and_read_back) {
  FakeCamera camera;
  auto source = camera.open();
  EXPECT_EQ(source->mode().exposure_ns, 0) << "automatic: not known";
  EXPECT_EQ(*source->set_exposure(5'000'000), 5'000'000);
  EXPECT_EQ(camera.controls, (Controls{{kAuto, V4L2_EXPOSURE_MANUAL}, {kTime, 50}}));
  EXPECT_EQ(*source->set_exposure(5'049'999), 5'000'000);  // to the nearest 100 us
  EXPECT_EQ(*source->set_exposure(5'050'000), 5'100'000);
  EXPECT_EQ(*source->set_exposure(1), 300'000);  // within its range
  EXPECT_EQ(*source->set_exposure(10'000'000'000), 204'700'000);
  camera.step = 16;  // a camera that takes another value than it was given
  EXPECT_EQ(*source->set_exposure(5'000'000), 4'800'000);
  EXPECT_EQ(source->mode().exposure_ns, 4'800'000);
}

TEST(V4l2Exposure, in_force_travels_with_each_frame) {
  FakeCamera camera;
  auto source = camera.open();
  ASSERT_TRUE(source->start());
  ASSERT_TRUE(source->set_exposure(2'000'000));
  EXPECT_EQ(source->next(0)->info.exposure_ns, 2'000'000);
  ASSERT_TRUE(source->set_exposure(3'000'000));
  EXPECT_EQ(source->next(0)->info.exposure_ns, 3'000'000);
}

// Cameras take a new exposure some frames later: until then nobody knows which of the two a frame has.
TEST(V4l2Exposure, is_not_sure_of_frames_just_after_a_change) {
  FakeCamera camera;
  auto source = camera.open();
  ASSERT_TRUE(source->start());
  EXPECT_TRUE(source->next(0)->info.exposure_sure);
  const std::int64_t settles_ns = std::max<std::int64_t>(200'000'000, 4 * source->mode().frame_period_ns);
  const std::int64_t before_ns = monotonic_ns();
  ASSERT_TRUE(source->set_exposure(2'000'000));
  for (const std::int64_t stamp_ns : {before_ns - 50'000'000, before_ns, before_ns + settles_ns - 1'000'000}) {
    camera.stamp_ns = stamp_ns;
    EXPECT_FALSE(source->next(0)->info.exposure_sure);
  }
  const std::int64_t later_ns = monotonic_ns() + settles_ns + 1'000'000;
  camera.stamp_ns = later_ns;
  EXPECT_TRUE(source->next(0)->info.exposure_sure);
  ASSERT_TRUE(source->set_exposure(2'000'000));  // the same changes nothing
  EXPECT_TRUE(source->next(0)->info.exposure_sure);
  source->restore_exposure();
  EXPECT_EQ(camera.controls, kFound);
  camera.stamp_ns = before_ns;
  EXPECT_FALSE(source->next(0)->info.exposure_sure);
  EXPECT_EQ(source->mode().exposure_ns, 0) << "automatic again";
}

TEST(V4l2Exposure, is_left_alone_by_a_source_that_did_not_set_it) {
  FakeCamera camera;
  camera.controls = {{kAuto, V4L2_EXPOSURE_MANUAL}, {kTime, 77}};
  auto source = camera.open();
  EXPECT_EQ(source->mode().exposure_ns, 7'700'000);
  camera.controls[kTime] = 99;  // by somebody else
  source.reset();
  EXPECT_EQ(camera.controls[kTime], 99);
}

TEST(V4l2Exposure, is_put_back_as_it_was_found) {
  for (const int automatic :
       {V4L2_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL, V4L2_EXPOSURE_SHUTTER_PRIORITY, V4L2_EXPOSURE_APERTURE_PRIORITY}) {
    for (const bool streaming : {false, true}) {
      FakeCamera camera;
      camera.controls[kAuto] = automatic;
      const Controls found = camera.controls;
      auto source = camera.open();
      if (streaming) {
        ASSERT_TRUE(source->start());
      }
      ASSERT_TRUE(source->set_exposure(5'000'000));
      ASSERT_TRUE(source->set_exposure(6'000'000));
      EXPECT_EQ(camera.controls[kTime], 60);
      source.reset();
      EXPECT_EQ(camera.controls, found) << automatic << (streaming ? " streaming" : "");
    }
  }
}

TEST(V4l2Exposure, of_a_camera_without_an_automatic_is_put_back) {
  FakeCamera camera;
  camera.controls.erase(kAuto);
  auto source = camera.open();
  EXPECT_EQ(source->mode().exposure_ns, 15'600'000);
  EXPECT_EQ(*source->set_exposure(5'000'000), 5'000'000);
  source.reset();
  EXPECT_EQ(camera.controls, (Controls{{kTime, 156}}));
}

TEST(V4l2Exposure, is_put_back_after_a_stream_that_failed) {
  for (const unsigned long request : {VIDIOC_REQBUFS, VIDIOC_QUERYBUF, VIDIOC_QBUF, VIDIOC_STREAMON, VIDIOC_DQBUF}) {
    FakeCamera camera;
    auto source = camera.open();
    ASSERT_TRUE(source->set_exposure(5'000'000));
    camera.failing = {request};
    const bool good = source->start() && source->next(0);
    EXPECT_FALSE(good);
    source.reset();
    EXPECT_EQ(camera.controls, kFound);
  }
}

// The automatic is off already when the time is refused.
TEST(V4l2Exposure, that_is_refused_names_the_control_and_is_put_back) {
  FakeCamera camera;
  auto source = camera.open();
  camera.unwritable = kTime;
  const auto set = source->set_exposure(5'000'000);
  ASSERT_FALSE(set);
  EXPECT_EQ(set.error().kind, Kind::system);
  EXPECT_EQ(set.error().errno_value, EIO);
  EXPECT_THAT(set.error().message, HasSubstr("exposure_time_absolute"));
  EXPECT_EQ(camera.controls[kAuto], V4L2_EXPOSURE_MANUAL);
  source.reset();
  EXPECT_EQ(camera.controls, kFound);

  auto again = camera.open();
  camera.unwritable = kAuto;
  const auto refused = again->set_exposure(5'000'000);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("auto_exposure"));
  again.reset();
  EXPECT_EQ(camera.controls, kFound);
}

// What was found is what was there before the first attempt, whatever a later one sees.
TEST(V4l2Exposure, that_cannot_be_read_still_puts_the_automatic_back) {
  FakeCamera camera;
  auto source = camera.open();
  camera.unreadable = kTime;
  const auto set = source->set_exposure(5'000'000);
  ASSERT_FALSE(set);
  EXPECT_EQ(set.error().errno_value, EIO);
  EXPECT_FALSE(source->set_exposure(5'000'000));
  camera.unreadable = 0;
  EXPECT_EQ(*source->set_exposure(5'000'000), 5'000'000);
  source.reset();
  EXPECT_EQ(camera.controls[kAuto], V4L2_EXPOSURE_APERTURE_PRIORITY);
}

TEST(V4l2Exposure, of_a_camera_that_is_unplugged_is_told_and_harmless) {
  FakeCamera camera;
  auto source = camera.open();
  ASSERT_TRUE(source->set_exposure(5'000'000));
  camera.unplugged = true;
  const auto set = source->set_exposure(6'000'000);
  ASSERT_FALSE(set);
  EXPECT_EQ(set.error().kind, Kind::unplugged);
  EXPECT_EQ(set.error().errno_value, ENODEV);
  EXPECT_THAT(set.error().message, HasSubstr("connect the camera"));
}

constexpr std::uint32_t kGain = V4L2_CID_GAIN, kWhite = V4L2_CID_AUTO_WHITE_BALANCE,
                        kWarmth = V4L2_CID_WHITE_BALANCE_TEMPERATURE, kFocusing = V4L2_CID_FOCUS_AUTO,
                        kFocus = V4L2_CID_FOCUS_ABSOLUTE, kMains = V4L2_CID_POWER_LINE_FREQUENCY;

Controls many() {
  Controls controls = kFound;
  controls.insert({{kGain, 8}, {kWhite, 1}, {kWarmth, 4000}, {kFocusing, 1}, {kFocus, 30}, {kMains, 0}});
  return controls;
}

TEST(V4l2Controls, automatics_are_off_while_the_camera_is_open) {
  FakeCamera camera;
  camera.controls = many();
  auto source = camera.open();
  Controls still = many();
  still[kWhite] = still[kFocusing] = 0;
  EXPECT_EQ(camera.controls, still);
  source.reset();
  EXPECT_EQ(camera.controls, many());
}

TEST(V4l2Controls, named_ones_are_set_in_their_order_and_put_back_in_the_opposite) {
  FakeCamera camera;
  camera.controls = many();
  auto source = camera.open("?gain=32&focus_absolute=70&power_line_frequency=1");
  Controls set = many();
  set[kWhite] = set[kFocusing] = 0;
  set[kGain] = 32;
  set[kFocus] = 70;
  set[kMains] = 1;
  EXPECT_EQ(camera.controls, set);
  std::vector<std::uint32_t> order = camera.order;
  EXPECT_EQ(order, (std::vector<std::uint32_t>{kWhite, kFocusing, kGain, kFocus, kMains}));
  camera.order.clear();
  source.reset();
  EXPECT_EQ(camera.controls, many());
  std::reverse(order.begin(), order.end());
  EXPECT_EQ(camera.order, order);
}

TEST(V4l2Controls, an_automatic_that_is_named_stays_as_it_is_named) {
  FakeCamera camera;
  camera.controls = many();
  auto source = camera.open("?white_balance_automatic=1");
  EXPECT_EQ(camera.controls[kWhite], 1);
  EXPECT_EQ(camera.controls[kFocusing], 0);
}

TEST(V4l2Controls, what_is_missing_out_of_range_or_refused_is_named_and_nothing_stays_changed) {
  const std::pair<const char*, const char*> refused[] = {{"?sharpness=3", "no such control"},
                                                         {"?gain=5000", "0 to 2047"},
                                                         {"?focus_absolute=70&sharpness=3", "sharpness"}};
  for (const auto& [options, words] : refused) {
    FakeCamera camera;
    camera.controls = many();
    const auto source = open_frame_source(camera.address() + options);
    ASSERT_FALSE(source) << options;
    EXPECT_THAT(source.error().message, HasSubstr(words));
    EXPECT_EQ(camera.controls, many()) << options;
  }
  FakeCamera camera;
  camera.controls = many();
  camera.unwritable = kGain;
  const auto source = open_frame_source(camera.address() + "?gain=32");
  ASSERT_FALSE(source);
  EXPECT_EQ(source.error().errno_value, EIO);
  EXPECT_THAT(source.error().message, HasSubstr("gain to 32"));
  EXPECT_EQ(camera.controls, many());
  camera.unwritable = 0;
  camera.step = 5;
  const auto rounded = open_frame_source(camera.address() + "?gain=32");
  ASSERT_FALSE(rounded);
  EXPECT_THAT(rounded.error().message, HasSubstr("took 30"));
}

std::vector<std::uint8_t> counting_bytes(std::size_t count) {
  std::vector<std::uint8_t> out(count);
  for (std::size_t i = 0; i < count; ++i) out[i] = static_cast<std::uint8_t>(i * 7 + i / 251);
  return out;
}

// The chroma of NV12 is handed out where it lies behind the luma; YUYV has it among its own bytes; UYVY is taken apart.
TEST(V4l2Colour, ComesWithTheFrameAndWhatTheDriverSaysOfIt) {
  for (const std::uint32_t fourcc : {V4L2_PIX_FMT_NV12, V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_UYVY, V4L2_PIX_FMT_GREY}) {
    FakeCamera camera;
    camera.fourcc = fourcc;
    camera.stamp_ns = monotonic_ns();
    const auto source = camera.open();
    ASSERT_NE(source, nullptr);
    const auto bytes = counting_bytes(camera.plane_bytes(0));
    camera.content = bytes;
    ASSERT_TRUE(source->start());
    auto frame = source->next(0);
    ASSERT_TRUE(frame) << frame.error().message;
    const ColourCoding& colour = source->mode().colour;
    switch (fourcc) {
      case V4L2_PIX_FMT_NV12:
        EXPECT_EQ(colour.layout, ColourLayout::uv_cells);
        EXPECT_EQ(colour.stride_bytes, FakeCamera::kWidth);
        EXPECT_EQ(frame->bytes().size(), FakeCamera::kFrameBytes);
        EXPECT_EQ(frame->colour().data(), frame->bytes().data() + FakeCamera::kFrameBytes) << "nothing is copied";
        ASSERT_EQ(frame->colour().size(), FakeCamera::kFrameBytes / 2);
        EXPECT_TRUE(
            std::equal(frame->colour().begin(), frame->colour().end(), bytes.begin() + FakeCamera::kFrameBytes));
        break;
      case V4L2_PIX_FMT_YUYV:
        EXPECT_EQ(colour.layout, ColourLayout::yuyv);
        EXPECT_TRUE(frame->colour().empty());
        EXPECT_TRUE(std::equal(frame->bytes().begin(), frame->bytes().end(), bytes.begin(), bytes.end()));
        break;
      case V4L2_PIX_FMT_UYVY:
        EXPECT_EQ(colour.layout, ColourLayout::uv_pairs);
        ASSERT_EQ(frame->colour().size(), FakeCamera::kFrameBytes);
        for (std::size_t i = 0; i < FakeCamera::kFrameBytes; ++i) ASSERT_EQ(frame->colour()[i], bytes[2 * i]);
        break;
      default:
        EXPECT_EQ(colour, ColourCoding());
        EXPECT_TRUE(frame->colour().empty());
    }
    if (fourcc != V4L2_PIX_FMT_GREY) {
      EXPECT_EQ(colour.weights, LumaWeights::bt709);
      EXPECT_TRUE(colour.limited_range);
    }
  }
}

}  // namespace
}  // namespace celadon
