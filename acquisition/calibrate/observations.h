#pragma once
// What was seen, arranged for the bundle: each corner and line point with its weight and its residual.

#include <Eigen/Core>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibrate/calibration_views.h"
#include "acquisition/calibrate/estimate.h"

namespace celadon::calibrate {

struct CornerObservation {
  Eigen::Vector2d p_mm;  ///< on the print, nominal
  Eigen::Vector2d p_px;
  double sigma_px = 0;
  int half = 0;       ///< 0 or 1, like a chessboard's colours: neither half of two columns or rows lies in a line
  double weight = 1;  ///< 0: left out
  Eigen::Vector2d residual = Eigen::Vector2d::Zero();  ///< in standard deviations
};

struct PointObservation {
  Eigen::Vector2d p_px;
  double sigma_px = 0;
  double weight = 1;
  double residual = 0;     ///< in standard deviations
  double distance_mm = 0;  ///< from the plane
};

struct LineObservation {
  int laser = 0;
  int plane = -1;  ///< in Estimate::planes; -1: none
  bool used = true;
  std::vector<PointObservation> points;
};

/// What an axis that was sent to 0 may read.
constexpr double kAtZero_rad = 1e-3, kAtZero_mm = 0.05;

struct ViewObservation {
  int view = 0;        ///< in the input
  int placement = -1;  ///< -1: held
  int pose = 0;        ///< in Estimate::X_CB
  double encoder_rad = 0;
  double reference_rad = 0;  ///< encoder angle at which its pose is that of Estimate::X_CB
  AxisStop stop;
  bool used = true;
  std::vector<CornerObservation> corners;
  std::vector<LineObservation> lines;

  bool turned() const { return placement >= 0; }
  bool raised() const { return turned() && std::abs(stop.elevation_rad) > kAtZero_rad; }
  bool lifted() const { return turned() && std::abs(stop.lift_mm) > kAtZero_mm; }
  /// Head and lift stood where the rest of the machine is calibrated.
  bool at_zero() const { return !raised() && !lifted(); }
};

struct Observations {
  std::vector<ViewObservation> views;
  std::vector<LineObservation> platter;
  Measured pitch_x, pitch_y;
  double board_radius_mm = 0;             ///< of the outermost corner from the middle of the print, nominal
  std::map<int, Eigen::Vector2d> places;  ///< of the print's corners, nominal, by their ids
};

/// Every view a pose of its own, held; all weights 1. Views with fewer than 8 corners are not `used`.
/// Errors: a picture without a size, a corner that is not on the board, a number that is not finite or a standard
/// deviation that is not positive.
tl::expected<Observations, std::string> arrange(const CalibrationInput& input);

/// Pose that the board has, or would have, in the camera frame with head and lift at 0.
Eigen::Isometry3d pose_at_zero(const Estimate& estimate, const ViewObservation& view);
/// Pose of the board in the camera frame, where the head stood.
Eigen::Isometry3d pose_of(const Estimate& estimate, const ViewObservation& view);

/// Fills residual and distance_mm of every observation that has a pose and a plane, used or not.
void update_residuals(const Estimate& estimate, Observations& observations);

}  // namespace celadon::calibrate
