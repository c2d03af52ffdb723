#include "fitting/error_map.h"

#include <algorithm>

namespace celadon {

ErrorMap::ErrorMap(const BaseSurface& base)
    : start_(base.band_start),
      rows_per_unit_(kAlong / (base.band_end - base.band_start)),
      fine_per_unit_(static_cast<double>(kFine) / base.arcs.count()),
      columns_(kFine),
      sums_(std::size_t{kAlong} * kAround),
      counts_(sums_.size()) {
  const double range = base.arcs.count() * base.arcs.arc_rad();
  for (int k = 0; k < kFine; ++k) {
    const double angle = base.arcs.theta_of_v((k + 0.5) / fine_per_unit_) - base.arcs.start_rad();
    columns_[static_cast<std::size_t>(k)] =
        static_cast<std::uint8_t>(std::clamp(static_cast<int>(angle / range * kAround), 0, kAround - 1));
  }
}

void ErrorMap::merge(const ErrorMap& other) {
  for (std::size_t k = 0; k < sums_.size(); ++k) {
    sums_[k] += other.sums_[k];
    counts_[k] += other.counts_[k];
  }
}

ErrorMap ErrorMap::repeated(int sectors, bool mirrored) const {
  ErrorMap all = *this;
  for (int j = 0; j < kAround; ++j) {
    const double turns = (j + 0.5) / kAround * sectors;
    const int sector = static_cast<int>(turns);
    const double share = mirrored && sector % 2 == 1 ? 1 - (turns - sector) : turns - sector;
    const int from = std::clamp(static_cast<int>(share * kAround), 0, kAround - 1);
    for (int i = 0; i < kAlong; ++i) {
      const auto to_at = static_cast<std::size_t>(i * kAround + j), at = static_cast<std::size_t>(i * kAround + from);
      all.sums_[to_at] = sums_[at];
      all.counts_[to_at] = counts_[at];
    }
  }
  return all;
}

}  // namespace celadon
