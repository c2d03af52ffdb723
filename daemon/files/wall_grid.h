#pragma once
// Grids of points over a range over a cylinder that a mesh may join to triangles. README.md, "Meshes".

#include <cstddef>
#include <vector>

#include "fitting/range_function.h"

namespace celadon {

/// A tensor grid, `along` as BaseSurface says; around a whole turn theta's last line is its first one again.
struct WallGrid {
  std::vector<double> theta_rad, along;
  std::vector<double> r_mm;  ///< row by row of constant `along`, around() each

  bool closed = true;

  std::size_t around() const { return theta_rad.size() - (closed ? 1 : 0); }
  double r(std::size_t row, std::size_t column) const { return r_mm[row * around() + column % around()]; }
};

/// Grid lines by bounds on the second derivatives; no point of the wall is further than chord_mm from the two triangles
/// of any cell, with the diagonal from both starts to both ends. @throws as mesh_of
WallGrid wall_grid(const RangeFunction& range, double chord_mm);
/// On given lines. @throws std::invalid_argument if the range is not positive everywhere
WallGrid wall_grid(const RangeFunction& range, std::vector<double> theta_rad, std::vector<double> along);

}  // namespace celadon
