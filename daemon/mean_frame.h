#pragma once
// The mean of several frames: one frame as background would add its whole noise to every line.

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/scan_job.h"

namespace celadon {

class MeanFrame {
 public:
  static constexpr int kEnough = 8;  ///< frames of a background

  /// Errors: a frame of another size than those before.
  tl::expected<void, ScanStop> add(std::span<const std::uint8_t> bytes) {
    if (sum_.empty()) sum_.assign(bytes.size(), 0);
    if (sum_.size() != bytes.size()) {
      return tl::make_unexpected(
          ScanStop{ScanState::failed, "The camera changed its frame size from " + std::to_string(sum_.size()) + " to " +
                                          std::to_string(bytes.size()) + " bytes during the scan; restart it."});
    }
    for (std::size_t i = 0; i < bytes.size(); ++i) sum_[i] = static_cast<std::uint16_t>(sum_[i] + bytes[i]);
    ++count_;
    return {};
  }
  int count() const { return count_; }
  /// Rounded; empty without a frame.
  std::vector<std::uint8_t> mean() const {
    if (count_ == 0) return {};
    std::vector<std::uint8_t> mean(sum_.size());
    for (std::size_t i = 0; i < mean.size(); ++i) {
      mean[i] = static_cast<std::uint8_t>((sum_[i] + count_ / 2) / count_);
    }
    return mean;
  }

 private:
  std::vector<std::uint16_t> sum_;
  int count_ = 0;
};

}  // namespace celadon
