#pragma once
// What a calibration estimates, and the charts in which it is varied. README.md, "The bundle".

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>
#include <vector>

#include "acquisition/axis_stop.h"
#include "acquisition/calibrate/camera_projection.h"

namespace celadon::calibrate {

using Tangents = Eigen::Matrix<double, 3, 2>;

/// normal . p = distance in the camera frame. Varied as normal + tangents t (normalised), and moved by `offset` along
/// the normal at the anchor.
struct PlaneEstimate {
  int laser = 0;
  Eigen::Vector3d normal_C = Eigen::Vector3d::UnitX();
  double distance_mm = 0;
  Eigen::Vector3d anchor_C = Eigen::Vector3d::Zero();  ///< on the plane
  Tangents tangents_C = Tangents::Zero();              ///< unit vectors across the normal
};

/// The rotary axis: varied as direction + across u (normalised), point + across w.
struct AxisEstimate {
  Eigen::Vector3d direction_C = Eigen::Vector3d::UnitZ();  ///< upward
  Eigen::Vector3d point_C = Eigen::Vector3d::Zero();
  Tangents across_C = Tangents::Zero();
  double turn = 1;  ///< counter-clockwise angle about the direction per encoder angle: direction x scale
  /// What the encoder errs by once a turn, about the direction: of the cosine and the sine of its angle.
  Eigen::Vector2d once_a_turn_rad = Eigen::Vector2d::Zero();

  /// Angle about the direction from one angle of the encoder to another: equation (6).
  double turned_rad(double from_encoder_rad, double to_encoder_rad) const;
  /// Its derivative by the latter.
  double rate(double encoder_rad) const;
};

/// The platter's surface above the axis point: height + slope . (across^T (p - point)), along the axis.
struct PlatterEstimate {
  double height_mm = 0;
  Eigen::Vector2d slope = Eigen::Vector2d::Zero();
};

/// The line about which the head turns, where it is for a head at reading 0: varied as direction + across u
/// (normalised), point + across w.
struct ElevationEstimate {
  Eigen::Vector3d direction_C = Eigen::Vector3d::UnitX();  ///< right-handed for rising readings
  Eigen::Vector3d point_C = Eigen::Vector3d::Zero();
  Tangents across_C = Tangents::Zero();
  double scale = 1;  ///< true angle / reading
};

/// The way of the lift for a head at reading 0: varied as direction + across u (normalised).
struct LiftEstimate {
  Eigen::Vector3d direction_C = Eigen::Vector3d::UnitZ();  ///< for rising readings
  Tangents across_C = Tangents::Zero();
  double scale = 1;  ///< true height / reading
};

struct Estimate {
  CameraParameters camera{};
  Eigen::Vector2d pitch = Eigen::Vector2d::Ones();  ///< true / nominal length of the print along its x and y
  /// How far the board's surface is out of flat: sag . sag_shape() along its z.
  Eigen::Vector3d sag_mm = Eigen::Vector3d::Zero();
  double board_radius_mm = 1;
  std::optional<AxisEstimate> axis;
  std::vector<PlaneEstimate> planes;
  std::optional<PlatterEstimate> platter;
  std::optional<ElevationEstimate> elevation;
  std::optional<LiftEstimate> lift;
  std::vector<Eigen::Isometry3d> X_CB;  ///< of each held view, of each placement at its reference angle and stop 0
};

/// Where the head at a stop sees, in its own frame, what is at p_C for the head and the table at 0: equation (12).
/// An axis that the estimate does not have stands still.
Eigen::Isometry3d seen_from_stop(const Estimate& estimate, const AxisStop& stop);

/// X^2, X Y, Y^2 of a place of the print, nominal, in units of the board's radius.
inline Eigen::Vector3d sag_shape(const Eigen::Vector2d& p_mm, double board_radius_mm) {
  const Eigen::Vector2d p = p_mm / board_radius_mm;
  return {p.x() * p.x(), p.x() * p.y(), p.y() * p.y()};
}
/// Where a place of the print, nominal, is on the board.
inline Eigen::Vector3d on_board(const Estimate& estimate, const Eigen::Vector2d& p_mm) {
  return {estimate.pitch.x() * p_mm.x(), estimate.pitch.y() * p_mm.y(),
          estimate.sag_mm.dot(sag_shape(p_mm, estimate.board_radius_mm))};
}

/// A unit vector moved in its chart, and the derivative by the two coordinates.
struct MovedDirection {
  Eigen::Vector3d d;
  Tangents by;
};
MovedDirection moved_direction(const Eigen::Vector3d& d0, const Tangents& tangents, const double* t);

/// Two unit vectors across a unit vector and each other.
Tangents tangents_across(const Eigen::Vector3d& direction);

/// The numbers that are varied, in blocks: the camera, print and turn as they are, the others as charts about an
/// estimate.
struct Parameters {
  explicit Parameters(const Estimate& about);
  /// @pre `about` is what the parameters were made of
  Estimate moved(const Estimate& about) const;

  CameraParameters camera;
  std::array<double, 5> print;  ///< pitch, sag
  std::array<double, 4> axis{};
  std::array<double, 3> turn{1, 0, 0};  ///< per encoder angle, once a turn
  std::array<double, 3> platter{};
  std::array<double, 5> elevation{};  ///< tilts, shifts, scale
  std::array<double, 3> lift{};       ///< tilts, scale
  std::vector<std::array<double, 3>> planes;
  std::vector<std::array<double, 6>> poses;  ///< rotation vector on the left, then translation
};

/// The scanner frame of an estimate with an axis: z along it, origin where the platter is (without a platter: the axis
/// point), x along the first laser plane towards the camera (without planes: towards the camera).
Eigen::Isometry3d scanner_frame(const Estimate& estimate);

/// The same estimate with its charts about the scanner frame: axis point = origin, across = x and y; plane anchors =
/// feet of the origin, tangents = upward in the plane, and normal x upward; elevation axis: the point nearest to the
/// rotary axis, across = upward, and direction x upward; lift: across = x and y.
Estimate anchored(const Estimate& estimate);

}  // namespace celadon::calibrate
