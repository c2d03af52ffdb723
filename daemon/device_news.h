#pragma once
// News of devices that come to this computer or leave it, so that a machine plugged in again is found at once.

#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "acquisition/file_descriptor.h"

struct udev_monitor;

namespace celadon {

class DeviceNews {
 public:
  /// Who tells: udev where it runs, since by then its rules have given rights and names in /dev/v4l; else the kernel.
  /// Nobody: neither can be heard, as in containers of a user's own, and whoever waits for a device has to look by
  /// itself.
  enum class Source { nobody, kernel, udev };

  /// Has the device's name in sysfs, as "video0".
  using Tell = std::function<void(const std::string& device)>;

  /// Starts a thread that calls `tell` after a camera, a USB device or a serial port came, changed or went.
  explicit DeviceNews(Tell tell);
  ~DeviceNews();  ///< no call after it
  DeviceNews(const DeviceNews&) = delete;
  DeviceNews& operator=(const DeviceNews&) = delete;

  Source source() const { return source_; }

 private:
  struct Unref {
    void operator()(udev_monitor* monitor) const;
  };
  void listen();

  const Tell tell_;
  Source source_ = Source::nobody;
  std::unique_ptr<udev_monitor, Unref> monitor_;
  FileDescriptor stop_;
  std::thread thread_;
};

}  // namespace celadon
