#pragma once
// Where a surface misses its samples: mean errors on a grid over angle and the coordinate along the base.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "fitting/base_surface.h"

namespace celadon {

/// Fields of equal angle (the arcs' range in kAround) and equal shares of the band (kAlong).
class ErrorMap {
 public:
  static constexpr int kAround = 180, kAlong = 60;
  ErrorMap() = default;
  explicit ErrorMap(const BaseSurface& base);
  /// @pre 0 <= v <= arcs, along within the band
  void add(double v, double along, double error_mm) {
    const auto at = static_cast<std::size_t>(row_of(along) * kAround + column_of(v));
    sums_[at] += error_mm;
    ++counts_[at];
  }
  /// Those of both. @pre of the same base
  void merge(const ErrorMap& other);
  /// Of a surface that consists of `sectors` of this one's, every second mirrored if asked for.
  ErrorMap repeated(int sectors, bool mirrored) const;
  bool empty() const { return counts_.empty(); }
  /// Mean error; nullopt: no samples.
  std::optional<double> mean_mm(int along, int around) const {
    const auto at = static_cast<std::size_t>(along * kAround + around);
    return counts_[at] == 0 ? std::nullopt : std::optional(sums_[at] / counts_[at]);
  }

 private:
  static constexpr int kFine = 4096;  // equal shares of v, each with its field of angles
  int row_of(double along) const {
    const int row = static_cast<int>((along - start_) * rows_per_unit_);
    return row < 0 ? 0 : row < kAlong ? row : kAlong - 1;
  }
  int column_of(double v) const {
    const int fine = static_cast<int>(v * fine_per_unit_);
    return columns_[static_cast<std::size_t>(fine < kFine ? fine : kFine - 1)];
  }
  double start_ = 0, rows_per_unit_ = 0, fine_per_unit_ = 0;
  std::vector<std::uint8_t> columns_;
  std::vector<double> sums_;
  std::vector<std::uint32_t> counts_;
};

}  // namespace celadon
