// News of devices by libudev on a mocked netlink socket: the preloaded library answers the system calls.
#include "daemon/device_news.h"

#include <gtest/gtest.h>
#include <umockdev.h>

#include <algorithm>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

namespace celadon {
namespace {

struct Unref {
  void operator()(UMockdevTestbed* testbed) const { g_object_unref(testbed); }
};

class DeviceNewsTest : public testing::Test {
 protected:
  /// The testbed sends the event of an arrival by itself, and no other.
  void plug(const std::string& path, const std::string& subsystem, const std::string& more = "") {
    const std::string text = "P: " + path + "\nE: SUBSYSTEM=" + subsystem + "\n" + more;
    GError* error = nullptr;
    if (umockdev_testbed_add_from_string(testbed_.get(), text.c_str(), &error) == 0) FAIL() << error->message;
  }
  void unplug(const std::string& path) {
    umockdev_testbed_uevent(testbed_.get(), ("/sys" + path).c_str(), "remove");
    umockdev_testbed_remove_device(testbed_.get(), ("/sys" + path).c_str());
  }
  void told(const std::string& device) {
    const std::lock_guard lock(mutex_);
    told_.push_back(device);
    changed_.notify_all();
  }
  /// Blocks until there was news of that device. @returns all news until then; forgets it
  std::vector<std::string> news_up_to(const std::string& device) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return std::count(told_.begin(), told_.end(), device) > 0; });
    return std::exchange(told_, {});
  }

 private:
  std::unique_ptr<UMockdevTestbed, Unref> testbed_{umockdev_testbed_new()};
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::string> told_;
};

TEST_F(DeviceNewsTest, TellsOfCamerasUsbDevicesAndSerialPortsThatComeAndGo) {
  const DeviceNews listener([this](const std::string& device) { told(device); });
  EXPECT_NE(listener.source(), DeviceNews::Source::nobody);
  const std::string camera = "/devices/usb1/1-1/1-1:1.0/video4linux/video7";
  plug("/devices/usb1/1-1", "usb", "E: DEVTYPE=usb_device\n");
  news_up_to("1-1");
  plug(camera, "video4linux");
  news_up_to("video7");
  plug("/devices/usb1/1-2/tty/ttyACM0", "tty");
  news_up_to("ttyACM0");
  unplug(camera);
  news_up_to("video7");
}

TEST_F(DeviceNewsTest, OtherDevicesAreNoNews) {
  const DeviceNews listener([this](const std::string& device) { told(device); });
  plug("/devices/pci0/sound/card0", "sound");
  plug("/devices/usb1/1-1/1-1:1.0", "usb", "E: DEVTYPE=usb_interface\n");
  plug("/devices/usb1/1-1", "usb", "E: DEVTYPE=usb_device\n");
  EXPECT_EQ(news_up_to("1-1"), std::vector<std::string>{"1-1"});  // they come in their order
}

}  // namespace
}  // namespace celadon
