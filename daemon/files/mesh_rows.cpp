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
  const auto bottom = static_cast<std::uint32_t>(rows * around), top = bottom + 1;
  if (body.closed) {
    mesh.vertices_mm.push_back(body.bottom);
    mesh.vertices_mm.push_back(body.top);
  }

  mesh.triangles.reserve(2 * rows * around);
  const auto vertex = [&](std::size_t i, std::size_t j) { return static_cast<std::uint32_t>(i * around + j % around); };
  for (std::size_t i = 0; i + 1 < rows; ++i) {
    for (std::size_t j = 0; j + (body.closed ? 0 : 1) < around; ++j) {
      mesh.triangles.push_back({vertex(i, j), vertex(i, j + 1), vertex(i + 1, j + 1)});
      mesh.triangles.push_back({vertex(i, j), vertex(i + 1, j + 1), vertex(i + 1, j)});
    }
  }
  if (!body.closed) return mesh;
  for (std::size_t j = 0; j < around; ++j) {
    mesh.triangles.push_back({bottom, vertex(0, j + 1), vertex(0, j)});
    mesh.triangles.push_back({top, vertex(rows - 1, j), vertex(rows - 1, j + 1)});
  }
  return mesh;
}

}  // namespace celadon
