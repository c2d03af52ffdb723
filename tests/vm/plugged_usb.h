#pragma once
// A USB device of the test's own in this machine's kernel: USB/IP on a socket pair to vhci-hcd, served by a thread. The
// test sees what the driver really sent and gives what the device answers.

#include <mutex>
#include <string>
#include <thread>

#include "sim/file_descriptor.h"
#include "sim/usb_device.h"

namespace celadon {

class PluggedUsb {
 public:
  /// Plugs it in and waits until the driver has made a node in /dev. @pre the device outlives it
  PluggedUsb(sim::UsbDevice& device, std::string node);
  /// Unplugs it and waits until the node is gone.
  ~PluggedUsb();
  PluggedUsb(const PluggedUsb&) = delete;
  PluggedUsb& operator=(const PluggedUsb&) = delete;

  void unplug();
  /// Runs f() while no transfer is served.
  template <class F>
  auto locked(F f) const {
    const std::lock_guard lock(mutex_);
    return f();
  }

 private:
  void serve();

  sim::UsbDevice& device_;
  const std::string node_;
  sim::FileDescriptor socket_, stop_;
  mutable std::mutex mutex_;
  std::thread server_;
};

/// Waits until a node is there, or gone; looks again whenever one comes or goes in /dev.
void wait_for_node(const std::string& node, bool there);

}  // namespace celadon
