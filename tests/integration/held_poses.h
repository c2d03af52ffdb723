#pragma once
// Where an operator of the virtual scanner holds a board.

#include <cstdio>
#include <string>
#include <vector>

namespace celadon::testing {

/// Poses of a board in front of the camera: middle in mm, turns in degrees (sim/README.md, "Calibration targets").
/// @param raised_mm so that it clears the platter
inline std::vector<std::string> held_poses(double raised_mm) {
  std::vector<std::string> poses;
  int i = 0;
  for (const double side : {-45., 0., 45.}) {
    for (const double z : {34., 60., 94.}) {
      for (const double near : {-30., 35.}) {
        const double tilts[][3] = {{0, 38, 35}, {0, -30, 25}, {10, 0, 60}, {-10, 38, 0}, {20, 15, 45}, {-20, -25, 15}};
        const auto& tilt = tilts[i++ % 6];
        // The camera stands 30 degrees beside the x axis.
        const double x = 0.87 * near - 0.5 * side, y = 0.5 * near + 0.87 * side;
        char text[120];
        std::snprintf(text, sizeof text, "@held:%g,%g,%g,%g,%g,%g", x, y, z + raised_mm, tilt[0], tilt[1], tilt[2]);
        poses.emplace_back(text);
      }
    }
  }
  return poses;
}

}  // namespace celadon::testing
