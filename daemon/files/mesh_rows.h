#pragma once
// A body, or a wall that is open around, as rows of points, one above the other, and the triangles between them.

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "daemon/files/mesh_files.h"

namespace celadon {

/// Rows from bottom to top, the same number of points in each, counter-clockwise seen from above; `bottom` and `top`
/// are what the first and the last row run together in, if anything: a pole, or the middle of a cap.
struct MeshRows {
  std::optional<Eigen::Vector3d> bottom{}, top{};
  std::vector<std::vector<Eigen::Vector3d>> rows;
  bool closed = true;  ///< rows run around; else nothing joins their ends
};

/// Every cell between two rows is two triangles that share the diagonal from its lower start to its upper end.
/// @pre two rows or more, or one that runs together in a point
/// @throws std::length_error for more vertices than fit 32 bits
TriangleMesh mesh_of_rows(const MeshRows& body);

}  // namespace celadon
