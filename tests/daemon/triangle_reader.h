#pragma once
// Readers of binary STL and of the triangle PLY, and what can be asked of triangles: closedness, volume, distance.

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string_view>
#include <vector>

namespace celadon::testing {

struct Triangles {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<std::array<std::uint32_t, 3>> faces;
  std::vector<Eigen::Vector3d> normals;  ///< of the faces, as written (STL only)

  /// Every directed edge exactly once, and its opposite exactly once too.
  bool watertight() const;
  long euler_characteristic() const;
  double volume() const;
  double distance(const Eigen::Vector3d& point) const;
};

/// Vertices with equal coordinates become one. @throws std::runtime_error if the sizes do not fit
Triangles read_stl(std::string_view bytes);
Triangles read_ply_triangles(std::string_view bytes);

}  // namespace celadon::testing
