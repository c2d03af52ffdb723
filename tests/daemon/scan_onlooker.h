#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "daemon/scan_job.h"

namespace celadon {

/// Follows a scan and may interfere.
class ScanOnlooker final : public ScanObserver {
 public:
  std::function<void(const ScanProgress&)> at_progress = [](const ScanProgress&) {};
  std::vector<double> fractions;
  ScanProgress progress;
  int cancel_at = 1'000'000;

  void on_state(ScanState) override {}
  void on_progress(const ScanProgress& now) override {
    progress = now;
    fractions.push_back(now.fraction);
    at_progress(now);
  }
  void on_status(const DeviceStatus&) override {}
  std::optional<std::string> cancelled() override {
    if (cancel_at-- > 0) return std::nullopt;
    return "by the test";
  }
};

}  // namespace celadon
