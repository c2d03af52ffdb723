#pragma once
// Everything about one machine that turns pixels, stamps and encoder readings into the scanner frame; each number with
// its standard uncertainty. File grammar: CALIBRATION.md.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/axis_stop.h"
#include "acquisition/measured.h"
#include "acquisition/table_encoder.h"

namespace celadon {

/// Pinhole with Brown-Conrady distortion (OpenCV's order k1 k2 p1 p2 k3). Pixel centres at whole numbers.
struct CameraModel {
  int width_px = 0, height_px = 0;
  Measured fx_px, fy_px, cx_px, cy_px;
  std::array<Measured, 5> distortion;
};

/// Laser plane in the camera frame: normal . p = distance, |normal| = 1.
struct LaserPlane {
  int laser = 0;
  Eigen::Vector3d normal_C = Eigen::Vector3d::UnitX();
  double distance_mm = 0;
  double u_normal_rad = 0, u_distance_mm = 0;
};

/// Pose of the scanner frame (z = rotary axis, origin on the platter) in the camera frame: p_C = X_CW p_W at table
/// angle 0.
struct AxisPose {
  Eigen::Isometry3d X_CW = Eigen::Isometry3d::Identity();
  double u_direction_rad = 0, u_position_mm = 0;
};

/// The head (camera and lasers, one rigid body) turns about a fixed line of the scanner frame S, nominally horizontal
/// and through the rotary axis: X_SC(e) = R_E(scale * e) X_SC(0), R_E right-handed about the line, e the axis's
/// reading; `direction` is such that positive angles raise the head. At 0 the head is where AxisPose says.
struct ElevationAxis {
  Eigen::Vector3d origin_mm = Eigen::Vector3d::Zero();   ///< a point of the line, in S
  Eigen::Vector3d direction = Eigen::Vector3d::UnitX();  ///< in S, length 1
  double u_direction_rad = 0, u_origin_mm = 0;           ///< of each component across the line
  Measured scale{1, 0};                                  ///< true angle / reading of the axis
};

/// The table and all on it rise by scale * h along `direction` at the reading h: a point p_W of the object (table angle
/// 0, lift 0) is at p_S = R_z(theta) p_W + scale * h * direction.
struct LiftAxis {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  ///< in S, length 1, nominally z
  double u_direction_rad = 0;                            ///< of each component across it
  Measured scale{1, 0};                                  ///< true height / reading of the axis
};

/// A fiducial on the platter's rim, an AprilTag of the family tag36h11: the corners of its black square in S at table
/// angle 0, upper left, upper right, lower right, lower left of the upright tag.
struct RimTag {
  int number = 0;
  std::array<Eigen::Vector3d, 4> corners_mm{};
  double u_mm = 0;  ///< of each coordinate
};

/// Where elevation and rotary axis come nearest to each other: the centre of spherical samples.
struct AxisCrossing {
  double z_mm = 0;    ///< of the point on the rotary axis
  double gap_mm = 0;  ///< from there to the elevation axis
};
/// @pre the elevation axis is not parallel to the rotary axis
AxisCrossing crossing_of(const ElevationAxis& elevation);
/// R_E(scale * reading_rad): where the head's points of reading 0 are then, in S.
Eigen::Isometry3d head_turn(const ElevationAxis& elevation, double reading_rad);

/// instant(row) = stamp + stamp_offset + exposure_factor * exposure + row * line_time, in ns of the host clock.
struct TimeModel {
  Measured stamp_offset_ns, exposure_factor, line_time_ns;
};

/// Joint covariance of the numbers of a calibration, each named and varied as calibration_change.h says.
struct CalibrationCovariance {
  std::vector<std::string> names;
  Eigen::MatrixXd matrix;  ///< symmetric, positive semidefinite
};

struct Calibration {
  std::string machine;  ///< identity of the controller this belongs to
  std::string camera;   ///< CameraMode::identity
  std::string date;     ///< ISO 8601, UTC
  bool simulated = false;
  CameraModel camera_model;
  std::vector<LaserPlane> lasers;
  AxisPose axis;
  TableEncoder encoder;
  Measured scale{1, 0.003};  ///< true length / model length
  double systematic_mm = 0;  ///< systematic uncertainty of a radius: form tolerance of the model selection
  double u_drift_mm = 0;     ///< of a radius, by what changes between calibration and scan
  TimeModel time;
  std::optional<ElevationAxis> elevation;  ///< nullopt: the machine has none, or it is not calibrated
  std::optional<LiftAxis> lift;            ///< likewise
  std::vector<RimTag> rim_tags;            ///< empty: the platter has none, or nobody looked
  std::optional<CalibrationCovariance> covariance;
};

struct CalibrationError {
  std::string message;
};  ///< names file, line or field, value and remedy

/// From the camera to the object's frame at table angle 0, true mm (lengths times the scale): p_W(0) = M p_C + t, so
/// that p_W = R_z(-theta) p_W(0). At lift 0 the object's frame is the scanner's.
/// @throws std::invalid_argument for a stop off 0 of an axis that the calibration lacks
Eigen::Affine3d camera_to_object(const Calibration& calibration, const AxisStop& stop);

tl::expected<Calibration, CalibrationError> read_calibration(const std::filesystem::path& file);
tl::expected<Calibration, CalibrationError> parse_calibration(const std::string& text, const std::string& name);
std::string format_calibration(const Calibration& calibration);
/// Refuses a calibration of another machine, camera or image size, naming both values.
tl::expected<void, CalibrationError> check_calibration(const Calibration& calibration, const std::string& machine,
                                                       const std::string& camera, int width_px, int height_px);

}  // namespace celadon
