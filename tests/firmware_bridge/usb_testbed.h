#pragma once
// The virtual scanner's controller on a USB that the process believes: libusb talks to usbfs, umockdev answers its
// ioctls, the simulator's own USB device answers the transfers. With mishaps between them.

#include <umockdev.h>

#include <atomic>
#include <list>
#include <memory>
#include <mutex>
#include <string>

#include "firmware_bridge/clock.h"
#include "sim/usb_controller.h"

namespace celadon::test {

/// Controller on a device clock that moves by declared waits and by the bus time of each request.
class UsbMachine {
 public:
  /// with_axes: it has an elevation axis and a lift.
  explicit UsbMachine(const std::string& serial = "SIM-0001", bool with_axes = false);

  /// Runs `f(model)` under the lock.
  template <class F>
  auto with(F f) {
    const std::lock_guard lock(mutex_);
    return f(model_);
  }
  void advance_ms(std::int64_t ms) {
    with([ms](sim::DeviceModel& m) { m.advance_to(m.now_ns() + ms * 1'000'000); });
  }
  /// A press and its release, 200 ms.
  void press();

  // For the bus.
  std::optional<sim::Bytes> control(const UsbSetup& setup, std::span<const std::uint8_t> data);
  sim::UsbIn read(std::uint8_t address, std::size_t most);
  sim::UsbDevice& device() { return device_; }
  std::atomic<int> writes = 0;

 private:
  std::mutex mutex_;
  sim::DeviceModel model_;
  sim::UsbController controller_{model_};
  sim::UsbDevice device_;
};

class UsbMachineClock final : public Clock {
 public:
  explicit UsbMachineClock(UsbMachine& machine) : machine_(machine) {}
  std::int64_t now_ns() override {
    return machine_.with([](sim::DeviceModel& m) { return m.now_ns(); });
  }
  void sleep_until(std::int64_t time_ns) override {
    machine_.with([time_ns](sim::DeviceModel& m) { m.advance_to(time_ns); });
  }

 private:
  UsbMachine& machine_;
};

/// What becomes of the next control transfers, vendor requests only.
enum class UsbMishap : std::uint8_t { none, ignore, shorten, break_off };

/// One port of a bus.
class UsbPort {
 public:
  UsbPort(UMockdevTestbed* testbed, int number);
  ~UsbPort();
  UsbPort(const UsbPort&) = delete;
  UsbPort& operator=(const UsbPort&) = delete;

  void plug(UsbMachine& machine);
  void unplug();
  void mishap(UsbMishap m, int times = 1);

 private:
  struct Request {
    UMockdevIoctlData *urb = nullptr, *buffer = nullptr;
    bool ended = false;
    int status = 0;
  };
  static gboolean on_ioctl(UMockdevIoctlBase* base, UMockdevIoctlClient* client, gpointer self);
  void ioctl(UMockdevIoctlClient* client);
  void submit(UMockdevIoctlClient* client, UMockdevIoctlData* argument);
  void discard(UMockdevIoctlClient* client, UMockdevIoctlData* argument);
  void reap(UMockdevIoctlClient* client, UMockdevIoctlData* argument);
  bool complete(Request& request);
  bool complete_control(Request& request);

  UMockdevTestbed* testbed_;
  const int number_;
  std::string path_, node_;
  UMockdevIoctlBase* handler_ = nullptr;
  std::mutex mutex_;
  UsbMachine* machine_ = nullptr;  // by mutex_, like all below
  std::list<Request> requests_;
  UsbMishap mishap_ = UsbMishap::none;
  int mishaps_ = 0;
};

}  // namespace celadon::test
