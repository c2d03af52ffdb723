#pragma once
// The pose of a second set of samples and the surface of both, refined together. Source: README.md, "Two poses".

#include <Eigen/Geometry>
#include <cstdint>

#include <tl/expected.hpp>

#include "fitting/profile.h"
#include "fitting/range_fit.h"
#include "fitting/range_function.h"

namespace celadon {

/// What a pose that is nearly known may still move by.
enum class PoseFreedom : std::uint8_t {
  along_axis,   ///< a shift along the axis: another height of the lift
  along_about,  ///< and a turn about it: the object was put back against a stop
  all           ///< all six: it was picked up and put down again
};

struct JointPose {
  Eigen::Isometry3d X_12 = Eigen::Isometry3d::Identity();  ///< moves the second samples as given onto the first
  double shift_sd_mm = 0;  ///< standard deviation along the axis, if errors of samples are independent
  double turn_sd_rad = 0;  ///< of the turn about it; 0: not free, or the wall is round and every turn as good
  int iterations = 0;
};

/// Least squares over the coefficients of the wall and the pose at once: Gauss and Newton's steps of the pose after the
/// coefficients are eliminated, on samples reweighted by Tukey's biweight. Both sets count everywhere, also where only
/// one of them sees the wall.
/// @param wall a fit of both sets as they lie (or of the first alone) over a cylinder; its band and its knots set what
/// is fitted here
/// @param second in the wall's base frame like the first, off by no more than a few of the wall's features
/// @param noise_mm standard deviation of a sample
/// Errors: sets that have too little in common, or a wall that slides along a free motion.
tl::expected<JointPose, FitError> refine_pose(const RangeFunction& wall, ProfileStream& first, ProfileStream& second,
                                              PoseFreedom freedom, double noise_mm);

}  // namespace celadon
