#pragma once
// Pixels of a laser line to a profile in the scanner frame, each sample with its covariance.

#include <span>

#include "acquisition/angle_timeline.h"
#include "acquisition/calibration.h"
#include "acquisition/laser_line.h"
#include "fitting/profile.h"

namespace celadon {

/// Volume that can hold the object; samples outside are dropped (the platter, the background).
struct ScanVolume {
  double r_min_mm = 0.5, r_max_mm = 250, z_min_mm = 1, z_max_mm = 400;
};

/// Ray-plane intersection, undistorted, turned back by the table angle; one per laser. README.md, "Triangulation".
class Triangulator {
 public:
  /// @pre calibration.lasers holds the laser
  Triangulator(const Calibration& calibration, int laser, const ScanVolume& volume);

  struct Counts {
    int found = 0, ambiguous = 0, outside = 0, edge = 0;
  };
  /// Fills r, theta, z, covariance and row of `profile` (its other fields but table_angle_rad and time_ns are left).
  /// `angle_at(instant_ns)` gives the table angle at each row's own instant; the last row of a run at a jump of the
  /// line is dropped (mixed pixels).
  template <class AngleAt>
  Counts triangulate(std::span<const LineRow> rows, const FrameInfo& frame, AngleAt&& angle_at, Profile& profile) const;

  /// Instant of a row by the time model.
  std::int64_t row_instant_ns(const FrameInfo& frame, double row) const;
};

}  // namespace celadon
