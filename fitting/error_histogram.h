#pragma once
// RMS, 95th percentile and maximum of a stream of errors, in constant memory.

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace celadon {

/// Quantiles of absolute values to one part in 512 or better, from 2^-60 to 2^20; what is smaller counts as zero.
class ErrorHistogram {
 public:
  ErrorHistogram() : bins_(bin_of(kHigh) + 1) {}
  void add(double error) {
    const double size = std::abs(error);
    square_ += size * size;
    largest_ = std::max(largest_, size);
    ++count_;
    ++bins_[bin_of(std::min(size, kHigh))];
  }
  void merge(const ErrorHistogram& other) {
    square_ += other.square_;
    largest_ = std::max(largest_, other.largest_);
    count_ += other.count_;
    for (std::size_t k = 0; k < bins_.size(); ++k) bins_[k] += other.bins_[k];
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
      if (below >= wanted && below > 0) return k == 0 ? 0 : std::min(largest_, middle_of(k));
    }
    return largest_;
  }

 private:
  // The exponent and the first eight bits behind the point: 256 bins an octave.
  static constexpr int kShift = 44;
  static constexpr double kLow = 0x1p-60, kHigh = 0x1p20;
  static std::size_t bin_of(double size) {
    return size >= kLow ? ((std::bit_cast<std::uint64_t>(size) - std::bit_cast<std::uint64_t>(kLow)) >> kShift) + 1 : 0;
  }
  static double middle_of(std::size_t bin) {
    return std::bit_cast<double>(std::bit_cast<std::uint64_t>(kLow) + ((bin - 1) << kShift) +
                                 (std::uint64_t{1} << (kShift - 1)));
  }
  std::vector<std::uint32_t> bins_;
  std::size_t count_ = 0;
  double square_ = 0, largest_ = 0;
};

}  // namespace celadon
