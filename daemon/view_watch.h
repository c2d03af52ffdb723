#pragma once
// How the object stands in the picture all around: whether all of it is in view, and how bright the laser's line is.

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "acquisition/laser_line.h"
#include "daemon/checks/self_check.h"
#include "fitting/profile.h"

namespace celadon {

/// Of the profiles in one part of the turn.
struct ViewSector {
  std::uint64_t profiles = 0, rows = 0, saturated = 0;
  double amplitude = 0;                        ///< mean over the rows, grey levels; of saturated ones what is left
  std::uint64_t cut_above = 0, cut_below = 0;  ///< profiles whose upper or lower end lies on the picture's edge
};

struct ViewReading {
  static constexpr std::size_t kSectors = 24;  ///< of the turn, the first from theta = 0 on
  std::array<ViewSector, kSectors> sectors{};
  double bright_level = 0;  ///< of the line: one row in twenty is brighter
};

class ViewWatch {
 public:
  /// @param rows     the line in every row (column) of the picture, whose ends are the picture's edges
  /// @param profile  what of it lies in the scanner's volume
  void see(std::span<const LineRow> rows, const Profile& profile);
  ViewReading reading() const;

 private:
  std::array<ViewSector, ViewReading::kSectors> sectors_{};
  std::array<double, ViewReading::kSectors> amplitudes_{};  ///< sums
  std::array<std::uint64_t, 256> levels_{};                 ///< rows by their amplitude
};

/// What it says of the exposure.
struct ExposureAdvice {
  double exposure_ms = 0;  ///< in force
  double better_ms = 0;    ///< at which bright places come near, and not beyond, what the camera can tell apart
  bool is_good = false;    ///< the one in force is near enough to that
};
/// @param longest_ms  that the camera's frame period leaves room for
ExposureAdvice exposure_advice(const ViewReading& reading, double exposure_ms, double longest_ms);

/// Two checks of a dry turn. `view`: share of the profiles that run out of the picture; `exposure`: share of the rows
/// that are saturated, in the sector with most. Both fail where a scan would not show the object.
std::vector<SelfCheck> view_checks(const ViewReading& reading, const ExposureAdvice& exposure);

}  // namespace celadon
