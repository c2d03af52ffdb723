#pragma once
// A laser's line on the bare platter beside the object, against z = 0 of the calibration: in the mean of a turn's
// frames, which shows what is far below the noise of one.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "acquisition/calibration.h"
#include "acquisition/frame.h"
#include "acquisition/laser_line.h"

namespace celadon {

/// Height of a laser's line over the platter as it would be if the calibration still held, at some distance from the
/// axis.
struct PlatterHeight {
  double r_mm = 0, z_mm = 0;
  double sd_mm = 0;  ///< of z_mm, by the noise of the mean
};

/// Sums what the laser adds to the picture along each row, around the place at which the laser's plane meets the
/// platter. The object turns away beneath the mean; the line on the platter stays.
class PlatterLine {
 public:
  /// Places at more than kReach_mm over or under the platter are not looked at.
  static constexpr double kReach_mm = 4;
  /// @param along  rows or columns of the picture, as the line is searched
  /// @pre the calibration holds the laser
  PlatterLine(const Calibration& calibration, int laser, LineAlong along);
  /// @param picture  with the laser on
  /// @param dark     the mean of pictures with the laser off; empty: black
  /// @pre both in this mode, of the size that the calibration says
  void add(const CameraMode& mode, std::span<const std::uint8_t> picture, std::span<const std::uint8_t> dark);
  int laser() const { return laser_; }
  /// Of every 4 neighbouring rows that show a line, beyond `beyond_mm` of the axis, where no object stands.
  std::vector<PlatterHeight> heights(double beyond_mm) const;

 private:
  struct Row {
    double x_px = 0, r_mm = 0, z_by_px = 0;  ///< where the plane meets z = 0; r_mm = 0: nowhere in the picture
    std::size_t first_px = 0, count_px = 0;  ///< what is summed of it
    std::size_t first_sum = 0;               ///< where in sums_
  };
  std::optional<PlatterHeight> height(std::span<const Row> rows) const;
  int laser_ = 0, frames_ = 0;
  LineAlong along_;
  std::vector<Row> rows_;
  std::vector<std::int32_t> sums_;  ///< laser on minus off
};

}  // namespace celadon
