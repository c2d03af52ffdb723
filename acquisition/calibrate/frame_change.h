#pragma once
// From the charts of the bundle, in which elevation axis and lift lie in the camera's frame, to those of the file, in
// which they lie in the scanner's frame and go wherever that goes. README.md, (13).

#include <Eigen/Core>

#include "acquisition/calibrate/bundle.h"

namespace celadon::calibrate {

/// Derivative of the file's numbers by the bundle's, square, in the order of the layout.
/// @pre estimate.axis, anchored()
Eigen::MatrixXd in_scanner_frame(const Estimate& estimate, const SharedLayout& layout);

}  // namespace celadon::calibrate
