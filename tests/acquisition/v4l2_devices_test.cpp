#include "acquisition/v4l2_devices.h"

#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include <filesystem>
#include <fstream>

#include "tests/temporary_folder.h"

namespace celadon {
namespace {

TEST(V4l2Devices, NodesThatAreGoneSayWhy) {
  const testing::TemporaryFolder folder;
  for (const char* name : {"video9917", "video9002", "v4l-subdev0", "videox", "video12x"}) {
    std::filesystem::create_directory(folder.path() / name);
  }
  const auto devices = list_v4l2_devices(folder.path());
  ASSERT_EQ(devices.size(), 2u);
  EXPECT_EQ(devices[0].path, "/dev/video9002");
  EXPECT_EQ(devices[1].path, "/dev/video9917");
  EXPECT_NE(devices[0].problem.find("/dev/video9002 cannot be opened: No such file or directory; connect"),
            std::string::npos)
      << devices[0].problem;
}

TEST(V4l2Devices, AComputerWithoutCamerasHasNone) {
  EXPECT_TRUE(list_v4l2_devices("/nowhere").empty());
}

TEST(V4l2Devices, TheFormatThatSuitsBestIsTaken) {
  V4l2Device device;
  const auto offer = [&](std::uint32_t fourcc) { device.formats.push_back({fourcc, "", true, {}}); };
  EXPECT_EQ(preferred_format(device), nullptr);
  offer(V4L2_PIX_FMT_H264);
  EXPECT_EQ(preferred_format(device), nullptr);
  for (const std::uint32_t better : {V4L2_PIX_FMT_MJPEG, V4L2_PIX_FMT_SRGGB8, V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_NV12,
                                     V4L2_PIX_FMT_Y16, V4L2_PIX_FMT_GREY}) {
    offer(better);
    ASSERT_NE(preferred_format(device), nullptr);
    EXPECT_EQ(preferred_format(device)->fourcc, better);
  }
}

}  // namespace
}  // namespace celadon
