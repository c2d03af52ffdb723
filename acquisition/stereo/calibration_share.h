#pragma once
// What a calibration's uncertainty does to a point of a pair of pictures: it is common to all samples of a scan, so it
// is stated beside them, not within each one's covariance.

#include <Eigen/Core>

#include "acquisition/calibration.h"

namespace celadon {

/// Two rays to one point: pixels of the camera's pictures, and encoder's angles of the table.
struct MatchedPixels {
  Eigen::Vector2d first_px, second_px;
  double first_rad = 0, second_rad = 0;
};

/// The point nearest to both rays, in the object's frame, true mm.
/// @pre the rays are not parallel
Eigen::Vector3d point_of(const MatchedPixels& match, const Calibration& calibration);

/// Standard uncertainty of that point's distance from the table's axis, mm: J C J^T with the calibration's joint
/// covariance, the lasers' planes left out, by differences over one standard deviation; without one, that of a scale
/// and of all radii. The drift counts in either case.
double radius_uncertainty_mm(const MatchedPixels& match, const Calibration& calibration);

}  // namespace celadon
