#pragma once
// How an object lies that was turned upside down, from what both poses show of it. Source: README.md, "Two poses".

#include <Eigen/Geometry>

#include <tl/expected.hpp>

#include "fitting/profile.h"
#include "fitting/range_fit.h"
#include "fitting/range_function.h"

namespace celadon {

struct PoseAlignment {
  Eigen::Isometry3d X_12 = Eigen::Isometry3d::Identity();  ///< the second pose's frame in the first one's
  double overlap = 0;      ///< share of the second pose's points that lie on the wall of the first
  double scale_mm = 0;     ///< robust standard deviation of these about it
  double shift_sd_mm = 0;  ///< of the position along the axis, if errors of points are independent
  double turn_sd_rad = 0;  ///< of the turn about it; 0: the wall is round, every turn is as good
};

/// The second pose is the first one turned upside down about a level axis, and then stands anywhere near the axis: the
/// shift along the axis and the turn about it are searched, then all six are refined, five where the wall is round.
/// @param wall of the first pose, over a cylinder closed around, in the first pose's frame
/// @param second the samples of the second pose, in the same scanner's frame
/// Errors: poses that show less than a fifth in common; a wall that would slide (a cylinder): name the shift.
tl::expected<PoseAlignment, FitError> align_turned_over(const RangeFunction& wall, ProfileStream& second);

}  // namespace celadon
