#pragma once
// Watertight triangle meshes of a surface of revolution-like body, to a stated chord tolerance; binary STL and PLY.

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace celadon {

class RangeFunction;

/// Consistently oriented outward, vertices shared: closed, or the sheet of a part of the turn.
struct TriangleMesh {
  std::vector<Eigen::Vector3d> vertices_mm;
  std::vector<std::array<std::uint32_t, 3>> triangles;
};

/// The body of pieces that share their rims, bottom to top, and a cap on each end that is no pole: a plane disc, over a
/// sphere a fan. No point of a wall over a cylinder is further than chord_mm from the mesh: grid lines follow bounds on
/// the second derivatives of the range function, and every cell is proved; over a sphere every triangle has been
/// compared with the surface (README.md, "Meshes"). A single piece over a part of the turn becomes a sheet without
/// caps.
/// @pre chord_mm > 0, ranges positive, closed around the axis if there are several
/// @throws std::length_error if more than 100 million triangles would be needed
TriangleMesh mesh_of(std::span<const RangeFunction* const> pieces, double chord_mm);
TriangleMesh mesh_of(const RangeFunction& range, double chord_mm);

/// Complete file contents; deterministic. `header` is one line (simulated or not, chord tolerance, units). Coordinates
/// are 32-bit floats, as readers expect: they add up to 6e-8 of the size to the chord tolerance. STL keeps the first 80
/// bytes of the header.
std::string binary_stl(const TriangleMesh& mesh, const std::string& header);
std::string binary_ply(const TriangleMesh& mesh, const std::string& header);

}  // namespace celadon
