#pragma once
// By how much successive profiles jump together: what camera, laser, table or object shake by, whatever the object's
// shape. Source: README.md, "Self-checks".

#include <array>
#include <cstddef>
#include <limits>
#include <optional>
#include <vector>

#include "fitting/profile.h"

namespace celadon {

struct JitterResult {
  double mm = 0;             ///< standard deviation of what the samples of a profile have in common
  double noise_mm = 0;       ///< what of it the samples' own errors make
  double u_mm = 0;           ///< standard uncertainty of `mm`
  std::size_t profiles = 0;  ///< that were compared with their neighbours
};

/// Fed profile by profile as the table turns. In each image row the radius at a profile's angle is interpolated by a
/// cubic through those of the two profiles before and the two after it; what the rows are off by in common is the
/// profile's. The object's shape is smoother than that nearly everywhere, and medians do not mind where it is not.
class ProfileJitter {
 public:
  void add(const Profile& profile);

  /// nullopt: too few profiles stood between neighbours of the same laser.
  std::optional<JitterResult> result() const;

 private:
  static constexpr std::size_t kWindow = 5, kMiddle = kWindow / 2;
  struct Line {
    int laser = -1;
    double angle_rad = std::numeric_limits<double>::quiet_NaN();
    std::vector<double> r_mm;  ///< by image row; NaN: not seen
  };
  void compare();

  std::array<Line, kWindow> window_;           ///< the latest last
  std::vector<double> off_mm_;                 ///< by row, of the profile that is compared
  std::vector<double> common_mm_, noise_mm2_;  ///< by profile, for profiles whose errors have the variance 1
};

}  // namespace celadon
