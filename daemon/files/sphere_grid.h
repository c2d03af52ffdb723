#pragma once
// Grids of points over a range over a sphere that a mesh may join to triangles. README.md, "Meshes".

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "fitting/range_function.h"

namespace celadon {

/// Rows of constant w from below to above, scanner frame; a pole's row holds its point in every column.
struct SphereGrid {
  int fineness = 1;  ///< that the columns have
  std::vector<std::vector<Eigen::Vector3d>> rows;
};

/// Rows of even angles and columns of constant theta until every triangle is within chord_mm of the surface along rays
/// through the middles of its edges and its own, the diagonal being that from the lower start to the upper end.
/// @param columns_of angles, ascending, at a fineness; more of it gives more of them. Around a whole turn from 0 and
/// without its end, else with both ends of the range
/// @param fineness to begin with
/// @throws as mesh_of
SphereGrid sphere_grid(const RangeFunction& range, const std::function<std::vector<double>(int)>& columns_of,
                       int fineness, double chord_mm);

}  // namespace celadon
