#pragma once
// RMS, 95th percentile and maximum of a stream of errors, in constant memory.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace celadon {

/// Quantiles of absolute values to one part in 2^(1/256), from 1e-18 to 1e6.
class ErrorHistogram {
 public:
  ErrorHistogram() : bins_(static_cast<std::size_t>((kHigh - kLow) * kPerOctave) + 1) {}
  void add(double error) {
    const double size = std::abs(error);
    square_ += size * size;
    largest_ = std::max(largest_, size);
    ++count_;
    const double at = size > 0 ? (std::log2(size) - kLow) * kPerOctave : 0;
    ++bins_[static_cast<std::size_t>(std::clamp(at, 0.0, static_cast<double>(bins_.size() - 1)))];
  }
  std::size_t count() const { return count_; }
  double rms() const { return count_ ? std::sqrt(square_ / static_cast<double>(count_)) : 0; }
  double max() const { return largest_; }
  /// The value below which the share lies, the middle of its bin; never above the maximum.
  double quantile(double share) const {
    const auto wanted = static_cast<std::size_t>(std::ceil(share * static_cast<double>(count_)));
    std::size_t below = 0;
    for (std::size_t k = 0; k < bins_.size(); ++k) {
      below += bins_[k];
      if (below >= wanted && below > 0)
        return k == 0 ? 0 : std::min(largest_, std::exp2((static_cast<double>(k) + 0.5) / kPerOctave + kLow));
    }
    return largest_;
  }

 private:
  static constexpr double kLow = -60, kHigh = 20, kPerOctave = 256;
  std::vector<std::uint32_t> bins_;
  std::size_t count_ = 0;
  double square_ = 0, largest_ = 0;
};

}  // namespace celadon
