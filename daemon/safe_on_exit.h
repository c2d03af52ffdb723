#pragma once
// The one way out of whatever moves or lights the machine.

#include <optional>
#include <string>

#include "daemon/scan_job.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon {

/// Lasers off and motor stopped on every way out. Until then a cancel or the button also ends waits for a motion.
/// Nothing to do for a recording.
class SafeOnExit {
 public:
  SafeOnExit(ScannerDevice* device, ScanObserver& observer) : device_(device) {
    if (device_ == nullptr) return;
    device_->set_interrupt([&observer, device]() -> std::optional<std::string> {
      if (device->take_button_presses() > 0) return "by the button on the machine";
      return observer.cancelled();
    });
  }
  ~SafeOnExit() {
    if (device_ == nullptr) return;
    if (!done_) device_->make_safe();
    device_->set_interrupt({});
  }
  SafeOnExit(const SafeOnExit&) = delete;
  SafeOnExit& operator=(const SafeOnExit&) = delete;
  /// What is not safe; nullopt: all is.
  std::optional<std::string> now() {
    if (device_ == nullptr) return std::nullopt;
    done_ = true;
    const SafeReport left = device_->make_safe();
    return left.lasers_off && left.motor_stopped ? std::nullopt : std::optional(left.text);
  }

 private:
  ScannerDevice* device_;
  bool done_ = false;
};

}  // namespace celadon
