#pragma once
// What one frame sees of the machine's motion and light over its exposure.

#include <cstdint>
#include <vector>

#include "sim/table_pose.h"

namespace celadon::sim {

/// Axes and laser power over time, sampled on a regular grid that covers a frame's exposure.
struct MotionRecord {
  struct Sample {
    double angle_rad = 0, speed_rad_per_s = 0, laser_power = 0, second_laser_power = 0;
    double elevation_rad = 0, elevation_rad_per_s = 0, lift_mm = 0, lift_mm_per_s = 0;
  };
  std::int64_t first_ns = 0, step_ns = 1'000'000;
  std::vector<Sample> samples;

  /// Hermite interpolation. @pre samples is not empty; times outside are clamped
  double angle_rad(std::int64_t time_ns) const { return posture(time_ns).table_rad; }
  Posture posture(std::int64_t time_ns) const;
  /// Mean power of a laser (0 or 1) between two instants, piecewise linear.
  double mean_power(std::int64_t from_ns, std::int64_t to_ns, int laser = 0) const;
};

/// One frame to be rendered. Row y is exposed over [first_row_end_ns - exposure_ns, first_row_end_ns] + y *
/// line_time_ns.
struct Exposure {
  std::uint64_t seed = 0, frame = 0;
  std::int64_t first_row_end_ns = 0, exposure_ns = 0, line_time_ns = 0;
  MotionRecord motion;
  double ambient_factor = 1;  ///< room light relative to normal

  /// Table angle, and all axes, at a place of the exposure of a row: node -1 its begin, 0 its middle, 1 its end.
  double angle_at(double row, double node) const { return posture_at(row, node).table_rad; }
  Posture posture_at(double row, double node) const;
};

}  // namespace celadon::sim
