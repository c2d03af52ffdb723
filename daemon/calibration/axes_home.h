#pragma once
// The way back of the axes beside the table.

#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "daemon/scan_stops.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon {

/// Brings head and lift back to 0 on every way out, where the machine is fit to move: no fault, no open interlock, no
/// emergency stop. A press of its button ends that way, too.
class AxesHome {
 public:
  AxesHome(ScannerDevice& device, const Calibration& calibration) : device_(device), calibration_(calibration) {}
  ~AxesHome() {
    if (stays_ || !fit()) return;
    device_.set_interrupt([&device = device_]() -> std::optional<std::string> {
      if (device.take_button_presses() > 0) return "by the button on the machine";
      return std::nullopt;
    });
    (void)bring_axes_to({}, device_, calibration_);  // the reason for this way out is told already
    device_.set_interrupt({});
  }
  AxesHome(const AxesHome&) = delete;
  AxesHome& operator=(const AxesHome&) = delete;

  tl::expected<void, ScanStop> now() {
    stay();
    if (auto brought = bring_axes_to({}, device_, calibration_); !brought) return tl::make_unexpected(brought.error());
    return {};
  }
  /// They stay where they are.
  void stay() { stays_ = true; }

 private:
  bool fit() {
    const auto status = device_.poll();
    return status && status->interlock_closed && !status->emergency_stop && !status->local_action_needed &&
           status->fault_code == 0;
  }

  ScannerDevice& device_;
  const Calibration& calibration_;
  bool stays_ = false;
};

}  // namespace celadon
