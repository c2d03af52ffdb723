#pragma once
// A laser's line on the bare platter beside the object, against z = 0 of the calibration: every frame of a scan.

#include <cstddef>
#include <span>
#include <vector>

#include "acquisition/calibration.h"
#include "acquisition/laser_line.h"

namespace celadon {

/// Height of a laser's line over the platter as it would be if the calibration still held, at some distance from the
/// axis.
struct PlatterHeight {
  double r_mm = 0, z_mm = 0;
  double sd_mm = 0;  ///< of z_mm as frames scatter, over the root of their number
  int frames = 0;
};

/// Gathers, row by row, how far the line lies from the place at which the laser's plane meets the platter.
class PlatterLine {
 public:
  /// Places at more than kReach_mm over or under the platter are of something else.
  static constexpr double kReach_mm = 4;
  /// @pre the calibration holds the laser
  PlatterLine(const Calibration& calibration, int laser, LineAlong along);
  /// @param rows  of a frame, along rows or columns as the constructor was told
  void add(std::span<const LineRow> rows);
  int frames() const { return frames_; }
  int laser() const { return laser_; }
  /// Rows that showed a line there in at least a quarter of the frames, from beyond `beyond_mm` of the axis, where no
  /// object stands.
  std::vector<PlatterHeight> heights(double beyond_mm) const;

 private:
  struct Row {
    double x_px = 0, r_mm = 0, z_by_px = 0;  ///< where the plane meets z = 0; r_mm = 0: nowhere in the picture
    int count = 0;
    double sum_px = 0, sum_squares = 0;
  };
  int laser_ = 0, frames_ = 0;
  std::vector<Row> rows_;
};

}  // namespace celadon
