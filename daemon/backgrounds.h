#pragma once
// What is subtracted from frames: the picture with the laser off, one for each exposure that a turn has. Why they are
// measured and not scaled: README.md, "Exposure by the line's peaks".

#include <cstdint>
#include <cstdlib>
#include <span>
#include <utility>
#include <vector>

namespace celadon {

class Backgrounds {
 public:
  /// In place of one of the same exposure.
  void put(std::int64_t exposure_ns, std::vector<std::uint8_t> picture) {
    for (auto& [exposure, kept] : pictures_) {
      if (exposure != exposure_ns) continue;
      kept = std::move(picture);
      return;
    }
    pictures_.emplace_back(exposure_ns, std::move(picture));
  }
  /// That of the nearest exposure; empty where there is none.
  std::span<const std::uint8_t> of(std::int64_t exposure_ns) const {
    std::span<const std::uint8_t> nearest;
    std::int64_t least_ns = INT64_MAX;
    for (const auto& [exposure, picture] : pictures_) {
      const std::int64_t apart_ns = std::abs(exposure - exposure_ns);
      if (apart_ns < least_ns) least_ns = apart_ns, nearest = picture;
    }
    return nearest;
  }

 private:
  std::vector<std::pair<std::int64_t, std::vector<std::uint8_t>>> pictures_;
};

}  // namespace celadon
