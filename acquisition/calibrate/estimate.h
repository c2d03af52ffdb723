#pragma once
// What a calibration estimates, and the charts in which it is varied. README.md, "The bundle".

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>
#include <vector>

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
};

/// The platter's surface above the axis point: height + slope . (across^T (p - point)), along the axis.
struct PlatterEstimate {
  double height_mm = 0;
  Eigen::Vector2d slope = Eigen::Vector2d::Zero();
};

struct Estimate {
  CameraParameters camera{};
  Eigen::Vector2d pitch = Eigen::Vector2d::Ones();  ///< true / nominal length of the print along its x and y
  std::optional<AxisEstimate> axis;
  std::vector<PlaneEstimate> planes;
  std::optional<PlatterEstimate> platter;
  std::vector<Eigen::Isometry3d> X_CB;  ///< of each held view, of each placement at its reference angle
};

/// A unit vector moved in its chart, and the derivative by the two coordinates.
struct MovedDirection {
  Eigen::Vector3d d;
  Tangents by;
};
MovedDirection moved_direction(const Eigen::Vector3d& d0, const Tangents& tangents, const double* t);

/// Two unit vectors across a unit vector and each other.
Tangents tangents_across(const Eigen::Vector3d& direction);

/// The numbers that are varied, in blocks: the camera, pitch and turn as they are, the others as charts about an
/// estimate.
struct Parameters {
  explicit Parameters(const Estimate& about);
  /// @pre `about` is what the parameters were made of
  Estimate moved(const Estimate& about) const;

  CameraParameters camera;
  std::array<double, 2> pitch;
  std::array<double, 4> axis{};
  double turn = 1;
  std::array<double, 3> platter{};
  std::vector<std::array<double, 3>> planes;
  std::vector<std::array<double, 6>> poses;  ///< rotation vector on the left, then translation
};

/// The scanner frame of an estimate with an axis: z along it, origin where the platter is (without a platter: the axis
/// point), x along the first laser plane towards the camera (without planes: towards the camera).
Eigen::Isometry3d scanner_frame(const Estimate& estimate);

/// The same estimate with its charts about the scanner frame: axis point = origin, across = x and y; plane anchors =
/// feet of the origin, tangents = upward in the plane, and normal x upward.
Estimate anchored(const Estimate& estimate);

}  // namespace celadon::calibrate
