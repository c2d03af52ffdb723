#pragma once
// Heights at which a wall steps: shoulders of a turned part. No smooth range follows them. Source: README.md, "Steps".

#include <span>
#include <vector>

#include "fitting/first_look.h"

namespace celadon {

/// A plane step across the axis.
struct WallStep {
  double z_mm = 0;
  double jump_mm = 0;  ///< of the range, above minus below
};

/// Steps all around between two heights, from below. @param samples an even sample over a cylinder of so many arcs
std::vector<WallStep> find_steps(std::span<const SamplePoint> samples, int arcs, double z_start_mm, double z_end_mm);

}  // namespace celadon
