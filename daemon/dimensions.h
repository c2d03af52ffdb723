#pragma once
// Diameters and angles of round objects from scanned points, each with its standard uncertainty: what the points
// scatter and what the calibration does not know. README.md, "Dimensions".

#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/remeasured_points.h"
#include "daemon/dimension.h"

namespace celadon {

enum class RoundShape { cylinder, cone, sphere };

struct Dimensions {
  std::vector<Dimension> values;
  double form_mm = 0;   ///< standard deviation of the points about the shape
  double left_out = 0;  ///< share of the points that the shape does not follow
};

/// Least squares over the points that Tukey's biweight keeps. Points of one profile may err together: the scatter's
/// part counts profiles (points of one laser, table angle and stop), not points.
/// @param at_z_mm  of a cone: height of the scanner frame where the diameter is stated
/// Errors: fewer than 30 points or 12 profiles, or points that do not determine the shape.
tl::expected<Dimensions, std::string> dimensions_of(RoundShape shape, const ScannedPoints& points,
                                                    const Calibration& calibration, double at_z_mm = 0);

}  // namespace celadon
