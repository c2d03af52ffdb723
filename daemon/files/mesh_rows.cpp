#include "daemon/files/mesh_rows.h"

#include <limits>
#include <stdexcept>

namespace celadon {

TriangleMesh mesh_of_rows(const MeshRows& body) {
  const std::size_t rows = body.rows.size(), around = body.rows.front().size();
  if (rows * around + 2 > std::numeric_limits<std::uint32_t>::max()) {
    throw std::length_error("mesh_of_rows: more vertices than 32 bits can number");
  }
  TriangleMesh mesh;
  mesh.vertices_mm.reserve(rows * around + 2);
  for (const auto& row : body.rows) mesh.vertices_mm.insert(mesh.vertices_mm.end(), row.begin(), row.end());
  const auto vertex = [&](std::size_t i, std::size_t j) { return static_cast<std::uint32_t>(i * around + j % around); };
  const std::size_t cells = around - (body.closed ? 0 : 1);
  mesh.triangles.reserve(2 * rows * around);
  for (std::size_t i = 0; i + 1 < rows; ++i) {
    for (std::size_t j = 0; j < cells; ++j) {
      mesh.triangles.push_back({vertex(i, j), vertex(i, j + 1), vertex(i + 1, j + 1)});
      mesh.triangles.push_back({vertex(i, j), vertex(i + 1, j + 1), vertex(i + 1, j)});
    }
  }
  const auto add_end = [&](const Eigen::Vector3d& end) {
    mesh.vertices_mm.push_back(end);
    return static_cast<std::uint32_t>(mesh.vertices_mm.size() - 1);
  };
  if (body.bottom) {
    const std::uint32_t bottom = add_end(*body.bottom);
    for (std::size_t j = 0; j < cells; ++j) mesh.triangles.push_back({bottom, vertex(0, j + 1), vertex(0, j)});
  }
  if (body.top) {
    const std::uint32_t top = add_end(*body.top);
    for (std::size_t j = 0; j < cells; ++j)
      mesh.triangles.push_back({top, vertex(rows - 1, j), vertex(rows - 1, j + 1)});
  }
  return mesh;
}

}  // namespace celadon
