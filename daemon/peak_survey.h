#pragma once
// How bright the laser's line is all around, beyond what one exposure can tell: the peaks of its rows from several
// passes, the longest exposure first.

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "acquisition/laser_line.h"
#include "fitting/profile.h"

namespace celadon {

/// Peaks by their brightness in grey levels per millisecond of exposure, in bins a quarter of an octave wide.
class PeakHistogram {
 public:
  void add(double levels_per_ms, double weight);
  void add(const PeakHistogram& other, double weight);
  double weight() const;
  /// Brightness that a share of the weight lies below: upper end of its bin. @pre weight() > 0
  double quantile(double share) const;
  /// Weight of what is darker. A bin counts as a whole, by its middle.
  double darker_than(double levels_per_ms) const;
  /// Only what is darker.
  PeakHistogram darker_part(double levels_per_ms) const;

 private:
  static constexpr double kBinsPerOctave = 4, kLowest_octave = -6;
  static constexpr std::size_t kBins = 96;
  static double middle_of(std::size_t bin);
  std::array<double, kBins> bins_{};
};

class PeakSurvey {
 public:
  static constexpr std::size_t kSectors = 72;  ///< of the turn of the table, the first from its angle 0 on
  static constexpr double kBrightest = 200;    ///< grey levels of a peak: from here on the next pass tells more
  static constexpr double kTop = 240;          ///< of a peak and the room's light together: from 250 on it is saturated

  /// @param exposure_ms  @pre shorter than that of the pass before
  /// @param room_levels  of the picture with the laser off where it is bright
  void begin_pass(double exposure_ms, double room_levels);
  /// @param rows      the line in every row (column) of the picture
  /// @param profile   what of it lies in the scanner's volume
  /// @param turn_rad  the table's angle
  void see(std::span<const LineRow> rows, const Profile& profile, double turn_rad);
  /// In some sector the present pass leaves more than one row in twenty to the next.
  bool asks_for_another() const;
  /// Rows a profile, by sector; of the last pass those too that it leaves, as bright as they seem.
  std::array<PeakHistogram, kSectors> reading() const;

  static std::size_t sector_of(double turn_rad);

 private:
  struct Sector {
    PeakHistogram peaks, too_bright;
    double profiles = 0;
  };
  struct Pass {
    double exposure_ms = 0, brightest = 0;  ///< brightest: levels of a peak that this pass tells
    std::array<Sector, kSectors> sectors{};
  };
  std::vector<Pass> passes_;
};

}  // namespace celadon
