#pragma once
// Grids of points over a range over a cylinder that a mesh may join to triangles. README.md, "Meshes".

#include <cstddef>
#include <vector>

#include "fitting/range_function.h"

namespace celadon {

/// A tensor grid; theta's last line is its first one again.
struct WallGrid {
  std::vector<double> theta_rad, z_mm;
  std::vector<double> r_mm;  ///< row by row of constant z, around() each

  std::size_t around() const { return theta_rad.size() - 1; }
  double r(std::size_t row, std::size_t column) const { return r_mm[row * around() + column % around()]; }
};

/// Grid lines by bounds on the second derivatives; no point of the wall is further than chord_mm from the two triangles
/// of any cell, with the diagonal from both starts to both ends. @throws as mesh_of
WallGrid wall_grid(const RangeFunction& range, double chord_mm);
/// On given lines. @throws std::invalid_argument if the range is not positive everywhere
WallGrid wall_grid(const RangeFunction& range, std::vector<double> theta_rad, std::vector<double> z_mm);

}  // namespace celadon
