#pragma once
// A camera and the boards' poses to start from: closed forms from homographies. README.md, "Initial values".

#include <string>

#include <tl/expected.hpp>

#include "acquisition/calibrate/observations.h"

namespace celadon::calibrate {

/// A camera without distortion whose principal point is the middle of the picture, and a pose for each view. Corners
/// that no homography explains get weight 0; views in which too many do not fit are not `used` any more.
/// Errors: fewer than three views that fit.
tl::expected<Estimate, std::string> initial_camera(Observations& observations, int width_px, int height_px);

/// Pose of a board by Gauss and Newton from some of its corners, the camera given.
/// @param half  of the corners, CornerObservation::half
/// @return whether it converged
bool refine_pose(const Estimate& estimate, const ViewObservation& view, int half, Eigen::Isometry3d& X_CB);

}  // namespace celadon::calibrate
