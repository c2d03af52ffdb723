#pragma once
// The mechanics of one machine's elevation axis and lift: nominal, with small errors that a calibration has to find.

#include <Eigen/Geometry>
#include <cstdint>

#include "sim/table_pose.h"

namespace celadon::sim {

/// Where the elevation axis crosses the table's axis, but for errors: the middle of what the default camera sees.
inline constexpr double kElevationHeight_mm = 60;

/// Of a head whose camera is at X_CW. Drawn from the seed, uniform: the elevation axis passes the table's axis by up to
/// 0.4 mm to each side, its height is wrong by up to 0.5 mm, it leans and turns by up to 3 mrad, its encoder's scale is
/// wrong by up to 0.1 %; the lift leans by up to 2 mrad, and its scale is wrong by up to 0.05 %.
MachineAxes draw_axes(std::uint64_t seed, const Eigen::Isometry3d& X_CW, bool with_elevation, bool with_lift);

}  // namespace celadon::sim
