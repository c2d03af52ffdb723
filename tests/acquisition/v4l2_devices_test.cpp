#include "acquisition/v4l2_devices.h"

#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "acquisition/v4l2_address.h"
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

/// Nodes of cameras on USB, by number and serial number; none can be opened.
class UsbNodes {
 public:
  void plug(int number, const std::string& serial) const {
    const std::string port = "port" + std::to_string(number);
    std::filesystem::create_directories(folder_.path() / port / "interface");
    std::ofstream(folder_.path() / port / "serial") << serial << "\n";
    const auto node = nodes() / ("video" + std::to_string(number));
    std::filesystem::create_directories(node);
    std::filesystem::create_directory_symlink(folder_.path() / port / "interface", node / "device");
  }
  std::filesystem::path nodes() const { return folder_.path() / "video4linux"; }

 private:
  testing::TemporaryFolder folder_;
};

TEST(V4l2Devices, ACameraIsFoundByItsSerialNumberWhateverItsNode) {
  const UsbNodes usb;
  usb.plug(9002, "CAM001");
  usb.plug(9917, "CAM002");
  EXPECT_EQ(find_v4l2_device("CAM001", usb.nodes()), "/dev/video9002");
  EXPECT_EQ(find_v4l2_device("CAM002", usb.nodes()), "/dev/video9917");
  const auto missing = find_v4l2_device("CAM00", usb.nodes());
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().kind, CameraError::Kind::not_found);
  EXPECT_NE(missing.error().message.find("v4l2:serial=CAM00: "), std::string::npos) << missing.error().message;
  usb.plug(9003, "CAM001");
  const auto several = find_v4l2_device("CAM001", usb.nodes());
  ASSERT_FALSE(several);
  EXPECT_EQ(several.error().kind, CameraError::Kind::unsupported);
  EXPECT_NE(several.error().message.find("/dev/video9002, /dev/video9003"), std::string::npos)
      << several.error().message;
}

TEST(V4l2Devices, AreNamedByTheSerialNumberThatNoOtherHas) {
  std::vector<V4l2Device> devices(4);
  for (std::size_t k = 0; k < devices.size(); ++k) devices[k].path = "/dev/video" + std::to_string(k);
  devices[0].serial = "CAM001";
  devices[1].serial = devices[2].serial = "0001";
  EXPECT_EQ(address_of(devices[0], devices), "v4l2:serial=CAM001");
  EXPECT_EQ(address_of(devices[1], devices), "v4l2:/dev/video1");
  EXPECT_EQ(address_of(devices[2], devices), "v4l2:/dev/video2");
  EXPECT_EQ(address_of(devices[3], devices), "v4l2:/dev/video3");
}

TEST(V4l2Devices, AnAddressNamesACameraBySerialNumberOrByPath) {
  const auto by_serial = parse_v4l2_address("serial=CAM001?width=640&gain=3");
  ASSERT_TRUE(by_serial);
  EXPECT_EQ(by_serial->serial, "CAM001");
  EXPECT_EQ(by_serial->path, "");
  EXPECT_EQ(by_serial->width, 640u);
  const auto by_path = parse_v4l2_address("/dev/v4l/by-id/usb-serial=1-index0");
  ASSERT_TRUE(by_path);
  EXPECT_EQ(by_path->serial, "");
  EXPECT_EQ(by_path->path, "/dev/v4l/by-id/usb-serial=1-index0");
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
