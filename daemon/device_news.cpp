#include "daemon/device_news.h"

#include <libudev.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <utility>

namespace celadon {

void DeviceNews::Unref::operator()(udev_monitor* monitor) const {
  udev_monitor_unref(monitor);
}

DeviceNews::DeviceNews(Tell tell) : tell_(std::move(tell)), stop_(::eventfd(0, EFD_CLOEXEC)) {
  udev* const context = udev_new();
  if (context == nullptr) return;
  const bool udev_runs = ::access("/run/udev/control", F_OK) == 0;
  monitor_.reset(udev_monitor_new_from_netlink(context, udev_runs ? "udev" : "kernel"));
  udev_unref(context);  // the monitor has its own reference
  udev_monitor* const monitor = monitor_.get();
  const bool heard = monitor != nullptr && stop_ &&
                     udev_monitor_filter_add_match_subsystem_devtype(monitor, "video4linux", nullptr) >= 0 &&
                     udev_monitor_filter_add_match_subsystem_devtype(monitor, "usb", "usb_device") >= 0 &&
                     udev_monitor_filter_add_match_subsystem_devtype(monitor, "tty", nullptr) >= 0 &&
                     udev_monitor_enable_receiving(monitor) >= 0;
  if (!heard) return;
  source_ = udev_runs ? Source::udev : Source::kernel;
  thread_ = std::thread([this] { listen(); });
}

DeviceNews::~DeviceNews() {
  const std::uint64_t one = 1;
  static_cast<void>(!::write(stop_.get(), &one, sizeof one));
  if (thread_.joinable()) thread_.join();
}

void DeviceNews::listen() {
  std::array<pollfd, 2> polls{pollfd{stop_.get(), POLLIN, 0}, pollfd{udev_monitor_get_fd(monitor_.get()), POLLIN, 0}};
  for (;;) {
    if (::poll(polls.data(), polls.size(), -1) < 0 && errno != EINTR) return;
    if (polls[0].revents != 0) return;
    if (udev_device* const device = udev_monitor_receive_device(monitor_.get())) {
      const char* const name = udev_device_get_sysname(device);
      tell_(name == nullptr ? "" : name);
      udev_device_unref(device);
    } else if (errno == ENOBUFS) {
      tell_("");  // more came at once than the kernel keeps
    } else if ((polls[1].revents & (POLLHUP | POLLNVAL)) != 0) {
      return;
    }
  }
}

}  // namespace celadon
