#include "daemon/bracketed_rows.h"

#include <algorithm>
#include <cstddef>

namespace celadon {
namespace {

constexpr double kFaintRow = 25;            // grey levels
constexpr double kSurelyUnsaturated = 150;  // of a peak, on the room's light

void keep_first(std::size_t samples, Profile& profile) {
  profile.r_mm.resize(samples);
  profile.theta_rad.resize(samples);
  profile.z_mm.resize(samples);
  profile.covariance.resize(samples);
  profile.row.resize(samples);
  if (!profile.colour.empty()) profile.colour.resize(samples);
}

}  // namespace

void leave_out(Profile& profile) {
  keep_first(0, profile);
}

void leave_to_other_exposure(std::span<const LineRow> rows, std::int64_t exposure_ns, std::int64_t other_ns,
                             Profile& profile) {
  if (exposure_ns == other_ns) return;
  const bool longer = exposure_ns > other_ns;
  // What would be saturated in the other turn is kept: nothing falls between the two.
  const double faint =
      std::min(kFaintRow, kSurelyUnsaturated * static_cast<double>(exposure_ns) / static_cast<double>(other_ns));
  std::size_t kept = 0;
  for (std::size_t k = 0; k < profile.size(); ++k) {
    const LineRow& row = rows[profile.row[k]];
    if (longer ? row.status == RowStatus::saturated : static_cast<double>(row.amplitude) < faint) continue;
    profile.r_mm[kept] = profile.r_mm[k];
    profile.theta_rad[kept] = profile.theta_rad[k];
    profile.z_mm[kept] = profile.z_mm[k];
    profile.covariance[kept] = profile.covariance[k];
    profile.row[kept] = profile.row[k];
    if (!profile.colour.empty()) profile.colour[kept] = profile.colour[k];
    ++kept;
  }
  keep_first(kept, profile);
}

}  // namespace celadon
