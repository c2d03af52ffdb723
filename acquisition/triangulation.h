#pragma once
// Pixels of a laser line to a profile in the scanner frame, each sample with its covariance.

#include <cstdint>
#include <span>
#include <vector>

#include <Eigen/Core>
#include <tl/expected.hpp>

#include "acquisition/angle_timeline.h"
#include "acquisition/axis_stop.h"
#include "acquisition/calibration.h"
#include "acquisition/laser_line.h"
#include "acquisition/lens.h"
#include "fitting/profile.h"

namespace celadon {

/// Volume of the object's frame that can hold the object; samples outside are dropped (the platter, the background).
struct ScanVolume {
  double r_min_mm = 0.5, r_max_mm = 250, z_min_mm = 1, z_max_mm = 400;
};

/// Whether a laser's line is to be searched in the rows or in the columns of the image: along which of them its place
/// tells more of the depth.
LineAlong line_along(const LaserPlane& plane);

/// Ray-plane intersection, undistorted, turned back by the table angle and lowered by the lift; one per laser and stop
/// of the axes beside the table. README.md, "Triangulation".
class Triangulator {
 public:
  /// @param along  as the rows to come were extracted; line_along() says what a calibration asks for
  /// @param stop    where the head and the table's lift stand
  /// @throws std::invalid_argument unless calibration.lasers holds the laser, the volume is not empty, and the axes
  /// that stand off 0 are calibrated
  Triangulator(const Calibration& calibration, int laser, const ScanVolume& volume, LineAlong along = LineAlong::rows,
               const AxisStop& stop = {});

  /// What became of the rows; those without a line are in none of the counts.
  struct Counts {
    int found = 0;      ///< samples in the profile
    int ambiguous = 0;  ///< two lines in the row
    int outside = 0;    ///< of the volume, or of what the plane and the camera can see
    int edge = 0;       ///< at a jump of the line (mixed pixels)
    int no_angle = 0;   ///< angle_at had no answer for the row's instant
  };
  /// Fills r, theta, z, covariance and row of `profile`, its table_angle_rad and time_ns (of the middle row; the angle
  /// counter-clockwise in the scanner frame: direction and encoder scale applied). The other fields are left.
  /// `angle_at(instant_ns)` gives the encoder's angle at each row's own instant as AngleAtInstant or
  /// tl::expected<AngleAtInstant, const char*>; it is asked at row instants at most 0.5 ms apart (up to 0.5 ms after
  /// the last row), and the angle is linear between them. The rows on both sides of a jump of the line are dropped
  /// (mixed pixels).
  /// @pre rows[i] is row i (along columns: column i) of the calibrated camera's image; at most 65535 of them
  template <class AngleAt>
  Counts triangulate(std::span<const LineRow> rows, const FrameInfo& frame, AngleAt&& angle_at,
                     Profile& profile) const {
    const auto call = [](void* callable, std::int64_t instant_ns) -> Angle {
      return (*static_cast<std::remove_reference_t<AngleAt>*>(callable))(instant_ns);
    };
    return triangulate(rows, frame, AngleAtRef{const_cast<void*>(static_cast<const void*>(&angle_at)), call}, profile);
  }

  LineAlong along() const { return along_; }
  /// Rows of a picture (columns, of a line along them).
  std::size_t line_count() const {
    return static_cast<std::size_t>(along_ == LineAlong::rows ? height_px_ : width_px_);
  }

  /// Whether a pixel's ray comes as near to the table's axis as that: a round body of the radius is seen there.
  bool meets_radius(double x_px, double row_px, double r_mm) const;

  /// Instant of a row by the time model.
  std::int64_t row_instant_ns(const FrameInfo& frame, double row) const;

 private:
  using Angle = tl::expected<AngleAtInstant, const char*>;
  /// A borrowed callable.
  struct AngleAtRef {
    void* callable;
    Angle (*call)(void*, std::int64_t);
    Angle operator()(std::int64_t instant_ns) const { return call(callable, instant_ns); }
  };
  /// One row's point in the object's frame at table angle 0, and its derivative by the position along the row (column).
  struct Point {
    double r_mm = 0, theta_rad = 0, z_mm = 0;
    double r_by_px = 0, theta_by_px = 0, z_by_px = 0;
    bool inside = false;
  };
  Counts triangulate(std::span<const LineRow> rows, const FrameInfo& frame, AngleAtRef angle_at,
                     Profile& profile) const;
  Point point(double x_px, double row_px) const;

  Lens lens_;
  LineAlong along_ = LineAlong::rows;
  int width_px_ = 0, height_px_ = 0;
  ScanVolume volume_;
  TableEncoder encoder_;
  Eigen::Vector3d normal_C_;  ///< of the laser plane
  double distance_mm_ = 0;
  Eigen::Matrix3d R_WC_;  ///< camera to object's frame at table angle 0, scaled
  Eigen::Vector3d p_WC_;
  TimeModel time_;
};

}  // namespace celadon
