#pragma once
// What a calibration's uncertainty does to numbers computed from scanned points: the pixels of the points stay, the
// points move with the calibration, and the numbers with the points. README.md, "Uncertainty of what is measured".

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "acquisition/calibration.h"

namespace celadon {

/// Scanned points and how they were lit. One entry a point in each, but that `stop` may be empty.
struct ScannedPoints {
  Eigen::Matrix3Xd p_mm;                ///< in the object's frame: turned back to table angle 0, lowered to lift 0
  std::vector<double> table_angle_rad;  ///< when the point was lit, counter-clockwise
  std::vector<int> laser;
  std::vector<AxisStop> stop = {};  ///< of head and lift; empty: all at 0
};

/// The points that the same pixels and encoder readings give with another calibration.
/// @pre every laser and every axis that stood off 0 is in both calibrations, the points before the camera
Eigen::Matrix3Xd remeasured(const ScannedPoints& points, const Calibration& measured_with, const Calibration& other);

/// Numbers computed from points. Smooth: differences over a standard deviation of the calibration are taken.
using Quantities = std::function<Eigen::VectorXd(const Eigen::Matrix3Xd& p_mm)>;

/// Covariance that the calibration's uncertainty gives the quantities: J C J^T with the derivatives J by central
/// differences over one standard deviation. Without a joint covariance: that of a scale and of all radii moved at once.
/// The drift moves all radii at once in either case. Of points off 0 of head and lift, what the axes' own sections
/// state counts where the joint covariance does not hold it.
Eigen::MatrixXd calibration_covariance_of(const Quantities& quantities, const ScannedPoints& points,
                                          const Calibration& calibration);

}  // namespace celadon
