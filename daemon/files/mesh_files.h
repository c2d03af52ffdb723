#pragma once
// Watertight triangle meshes of a surface of revolution-like body, to a stated chord tolerance; binary STL and PLY.

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace celadon {

class RangeFunction;

/// Closed, consistently oriented outward; shared vertices.
struct TriangleMesh {
  std::vector<Eigen::Vector3d> vertices_mm;
  std::vector<std::array<std::uint32_t, 3>> triangles;
};

/// The fitted wall and a plane disc at each end. No point of the wall is further than chord_mm from the mesh.
/// @pre chord_mm > 0
TriangleMesh mesh_of(const RangeFunction& range, double chord_mm);

/// Complete file contents; deterministic. `header` is one line (simulated or not, chord tolerance, units).
std::string binary_stl(const TriangleMesh& mesh, const std::string& header);
std::string binary_ply(const TriangleMesh& mesh, const std::string& header);

}  // namespace celadon
