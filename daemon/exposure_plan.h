#pragma once
// Which exposure each part of the turn has, and whether one is enough. README.md, "Exposure by the line's peaks".

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "daemon/peak_survey.h"

namespace celadon {

/// The exposures of one turn, by the table's angle. Empty: as the camera stands.
class ExposurePlan {
 public:
  static constexpr std::size_t kSectors = PeakSurvey::kSectors;

  ExposurePlan() = default;
  explicit ExposurePlan(const std::array<std::int64_t, kSectors>& exposures_ns)
      : exposures_ns_(exposures_ns.begin(), exposures_ns.end()) {}
  bool empty() const { return exposures_ns_.empty(); }
  /// @pre not empty
  std::int64_t at_ns(double turn_rad) const { return exposures_ns_[PeakSurvey::sector_of(turn_rad)]; }
  /// @pre not empty
  std::int64_t longest_ns() const;
  /// @pre not empty; sector < kSectors
  std::int64_t in_sector_ns(std::size_t sector) const { return exposures_ns_[sector]; }
  /// Different ones, the shortest first.
  std::vector<std::int64_t> values_ns() const;

  /// Sectors in a row with one exposure. One that goes over 360 degrees begins before them and ends beyond.
  struct Stretch {
    double from_deg = 0, to_deg = 0;
    std::int64_t exposure_ns = 0;
  };
  std::vector<Stretch> stretches() const;

 private:
  std::vector<std::int64_t> exposures_ns_;
};

/// What the camera and the room allow.
struct ExposureLimits {
  double longest_ms = 0, shortest_ms = 0;
  double room_levels_per_ms = 0;  ///< of the picture with the laser off where it is bright
  bool room_limits = false;       ///< the longest is what the room's light allows, not the frame period
};

struct ExposureChoice {
  std::vector<ExposurePlan> plans;     ///< a turn with each: one; two where no single one is enough, the shorter first
  std::vector<std::string> unreached;  ///< what no exposure reaches, a sentence each with the remedy
};

/// Exposures of the ladder longest / 2^k that bring the bright rows of each sector to 100 to 200 grey levels, in
/// stretches of 15 degrees and more; where more than one row in twenty is then below 12 levels in 15 degrees of the
/// turn or more, a second plan by those rows, which elsewhere is the first.
/// @pre some sector has peaks; limits > 0
ExposureChoice choose_exposures(const std::array<PeakHistogram, PeakSurvey::kSectors>& peaks,
                                const ExposureLimits& limits);

/// The same for turns of one exposure each, the longest of their plans: the first as the brightest sectors want it; a
/// second, where some want four times that and more, as the darkest want it, planned for those and their neighbours.
std::vector<ExposurePlan> one_exposure_a_turn(const std::vector<ExposurePlan>& plans);

}  // namespace celadon
