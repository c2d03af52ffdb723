// Buffers of one plane and of several, in the driver's memory and in ours, and drivers that lie about them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <string>
#include <vector>

#include "tests/acquisition/fake_v4l2_camera.h"

namespace celadon {
namespace {

using testing::HasSubstr;
using Kind = CameraError::Kind;

/// Every pixel, and nothing of the other plane or of what lies before the picture.
void expect_pixels(const Frame& frame, int pixel) {
  EXPECT_EQ(frame.bytes().size(), FakeCamera::kFrameBytes);
  EXPECT_EQ(std::count(frame.bytes().begin(), frame.bytes().end(), pixel), FakeCamera::kFrameBytes);
  EXPECT_FALSE(frame.info.corrupt);
}

struct Planes {
  const char* name;
  std::uint32_t fourcc, planes, data_offset;
};
class V4l2Planes : public testing::TestWithParam<std::tuple<Planes, bool>> {};

TEST_P(V4l2Planes, are_streamed_in_place_and_again_after_a_stop) {
  const auto& [form, own_memory] = GetParam();
  FakeCamera camera;
  camera.fourcc = form.fourcc;
  camera.planes = form.planes;
  camera.data_offset = form.data_offset;
  camera.maps_nothing = own_memory;
  auto source = camera.open();
  ASSERT_TRUE(source);
  int pixel = 0;
  for (int stream = 0; stream < 2; ++stream) {
    const auto started = source->start();
    ASSERT_TRUE(started) << started.error().message;
    for (int i = 0; i < 20; ++i, ++pixel) {
      const auto frame = source->next(0);
      ASSERT_TRUE(frame) << frame.error().message;
      expect_pixels(*frame, pixel);
    }
    source->stop();
  }
}

INSTANTIATE_TEST_SUITE_P(Forms, V4l2Planes,
                         testing::Combine(testing::Values(Planes{"single", V4L2_PIX_FMT_GREY, 0, 0},
                                                          Planes{"multi", V4L2_PIX_FMT_GREY, 1, 0},
                                                          Planes{"luma", V4L2_PIX_FMT_NV12M, 2, 0},
                                                          Planes{"luma_behind_a_header", V4L2_PIX_FMT_NV16M, 2, 128}),
                                          testing::Bool()),
                         [](const auto& test) {
                           return std::get<0>(test.param).name +
                                  std::string(std::get<1>(test.param) ? "_in_memory_of_ours" : "_mapped");
                         });

TEST(V4l2Planes, a_frame_that_is_not_whole_is_corrupt) {
  for (const std::uint32_t planes : {0u, 2u}) {
    FakeCamera camera;
    camera.planes = planes;
    camera.fourcc = planes == 0 ? V4L2_PIX_FMT_GREY : V4L2_PIX_FMT_NV12M;
    camera.data_offset = planes == 0 ? 0 : 128;
    auto source = camera.open();
    ASSERT_TRUE(source->start());
    // The bytes before the picture are counted by the driver and are none of the picture.
    camera.told_used = FakeCamera::kFrameBytes + camera.data_offset - 1;
    EXPECT_TRUE(source->next(0)->info.corrupt) << planes;
    camera.told_used = 1;
    EXPECT_TRUE(source->next(0)->info.corrupt) << planes;
    camera.told_used = FakeCamera::kFrameBytes + camera.data_offset;
    EXPECT_FALSE(source->next(0)->info.corrupt) << planes;
  }
}

TEST(V4l2Planes, what_a_driver_says_wrongly_is_named_and_not_read) {
  const std::pair<std::function<void(FakeCamera&)>, const char*> lies[] = {
      {[](FakeCamera& camera) { camera.told_planes = 1; }, "a buffer has 1 planes and the format 2"},
      {[](FakeCamera& camera) { camera.told_planes = 3; }, "a buffer has 3 planes and the format 2"},
      {[](FakeCamera& camera) { camera.told_index = 8; }, "the driver named buffer 8"}};
  for (const auto& [lie, words] : lies) {
    FakeCamera camera;
    camera.planes = 2;
    camera.fourcc = V4L2_PIX_FMT_NV12M;
    auto source = camera.open();
    lie(camera);
    const auto started = source->start();
    const auto frame = started ? source->next(0) : tl::expected<Frame, CameraError>(tl::unexpected(started.error()));
    ASSERT_FALSE(frame) << words;
    EXPECT_EQ(frame.error().kind, Kind::protocol);
    EXPECT_THAT(frame.error().message, HasSubstr(words));
  }
  FakeCamera camera;
  camera.planes = 2;
  camera.fourcc = V4L2_PIX_FMT_NV12M;
  auto source = camera.open();
  ASSERT_TRUE(source->start());
  camera.data_offset = 1;  // the mapped plane has no room for it
  const auto frame = source->next(0);
  ASSERT_FALSE(frame);
  EXPECT_EQ(frame.error().kind, Kind::protocol);
  EXPECT_THAT(frame.error().message, HasSubstr("begins at byte 1 of 4096 and needs 4096"));
}

}  // namespace
}  // namespace celadon
