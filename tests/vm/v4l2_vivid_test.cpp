// V4L2Source and the list of cameras against the kernel's vivid driver: what cameras are, offer and refuse; runs in the
// guest, with vivid loaded for /dev/video0 and 1 (single-planar), 2 and 3 (multi-planar).
#include <gmock/gmock.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>

#include <algorithm>
#include <string>
#include <vector>

#include "acquisition/frame.h"
#include "acquisition/v4l2_address.h"
#include "acquisition/v4l2_devices.h"
#include "tests/vm/vivid_camera.h"
#include "tests/vm/vivid_controls.h"

namespace celadon {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using Kind = CameraError::Kind;

constexpr const char* kDevice = "/dev/video0";

std::unique_ptr<FrameSource> opened(const std::string& options = "?width=640&height=360") {
  return open_vivid(kDevice, options);
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
  ASSERT_EQ(devices.size(), 4u);
  const auto luma_alone = [](const V4l2Device& camera) {
    return std::count_if(camera.formats.begin(), camera.formats.end(), [](const V4l2Format& format) {
      return format.usable && fourcc_text(format.fourcc) == "NM12";
    });
  };
  EXPECT_EQ(luma_alone(devices[0]), 0);
  EXPECT_EQ(luma_alone(devices[2]), 1) << "multi-planar";
  ASSERT_NE(preferred_format(devices[2]), nullptr);
  EXPECT_EQ(fourcc_text(preferred_format(devices[2])->fourcc), "GREY");
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

}  // namespace
}  // namespace celadon
