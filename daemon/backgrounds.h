#pragma once
// What is subtracted from frames: pictures with the laser off, for each exposure that a turn has, and where it was
// looked at all around for each part of the turn. Why they are measured and not scaled: README.md, "Exposure by the
// line's peaks".

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <numbers>
#include <optional>
#include <span>
#include <utility>
#include <vector>

namespace celadon {

class Backgrounds {
 public:
  static constexpr int kParts = 24;  ///< of the turn
  static int part_of(double turn_rad) {
    const double turns = turn_rad / (2 * std::numbers::pi);
    return static_cast<int>((turns - std::floor(turns)) * kParts) % kParts;
  }

  /// In place of one of the same exposure and part; no part: all around.
  void put(std::int64_t exposure_ns, std::optional<int> part, std::vector<std::uint8_t> picture) {
    for (Kept& kept : pictures_) {
      if (kept.exposure_ns != exposure_ns || kept.part != part) continue;
      kept.picture = std::move(picture);
      return;
    }
    pictures_.push_back({exposure_ns, part, std::move(picture)});
  }
  /// Of the nearest exposure that of the nearest part; empty where there is none.
  /// @param turn_rad  the table's angle
  std::span<const std::uint8_t> of(std::int64_t exposure_ns, double turn_rad) const {
    std::span<const std::uint8_t> nearest;
    std::pair<std::int64_t, int> least{INT64_MAX, kParts};
    for (const Kept& kept : pictures_) {
      const int off = kept.part ? std::abs(*kept.part - part_of(turn_rad)) : 0;
      const std::pair<std::int64_t, int> apart{std::abs(kept.exposure_ns - exposure_ns), std::min(off, kParts - off)};
      if (apart < least) least = apart, nearest = kept.picture;
    }
    return nearest;
  }

 private:
  struct Kept {
    std::int64_t exposure_ns;
    std::optional<int> part;
    std::vector<std::uint8_t> picture;
  };
  std::vector<Kept> pictures_;
};

}  // namespace celadon
