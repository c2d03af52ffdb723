#pragma once
// Closure of a turn: places seen at the start are looked at again after 360 degrees. A wrong number of steps, a
// slipping belt or an object that moved shows as a difference.

#include <optional>
#include <vector>

#include "daemon/report.h"
#include "fitting/profile.h"

namespace celadon {

class ClosureTest {
 public:
  /// @param overlap_rad how much of the turn is looked at twice
  explicit ClosureTest(double overlap_rad) : overlap_rad_(overlap_rad) {}

  /// A profile of the turn, `turned_rad` after its start; kept if it lies in the overlap.
  void first(double turned_rad, const Profile& profile);
  /// A profile beyond the turn, compared row by row with the two kept ones around turned_rad - 2 pi.
  void again(double turned_rad, const Profile& profile);
  /// Second minus first along r; nullopt when nothing could be compared. Blind to a wrong angle on a surface of
  /// revolution, which looks the same from everywhere.
  std::optional<ClosureError> result() const;

 private:
  struct Kept {
    double turned_rad;
    std::vector<float> r_mm;  ///< by image row; 0: no sample
  };
  double overlap_rad_;
  std::vector<Kept> kept_;
  double sum_ = 0, squares_ = 0;
  std::uint64_t samples_ = 0;
};

}  // namespace celadon
