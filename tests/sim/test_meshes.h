#pragma once
// Triangle meshes for tests, made from closed forms.

#include <cmath>
#include <numbers>

#include "daemon/files/mesh_files.h"

namespace celadon::testing {

/// A closed grid of points(i, j), i < n and j < m, that wraps both ways.
template <class Point>
TriangleMesh wrapped_grid(int n, int m, const Point& point) {
  TriangleMesh mesh;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < m; ++j) mesh.vertices_mm.push_back(point(i, j));
  }
  const auto at = [&](int i, int j) { return static_cast<std::uint32_t>(i % n * m + j % m); };
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < m; ++j) {
      mesh.triangles.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
      mesh.triangles.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
    }
  }
  return mesh;
}

/// A ring that lies on z = 0: its tube of radius `tube` about a circle of radius `ring`.
inline TriangleMesh torus(double ring, double tube, int n, int m) {
  return wrapped_grid(n, m, [=](int i, int j) {
    const double u = 2 * std::numbers::pi * i / n, v = 2 * std::numbers::pi * j / m;
    const double rho = ring + tube * std::cos(v);
    return Eigen::Vector3d(rho * std::cos(u), rho * std::sin(u), tube + tube * std::sin(v));
  });
}

/// A box on z = 0 with its axis at the origin.
inline TriangleMesh box(double x, double y, double z) {
  TriangleMesh mesh;
  for (int i = 0; i < 8; ++i) {
    mesh.vertices_mm.emplace_back((i & 1) != 0 ? x : -x, (i & 2) != 0 ? y : -y, (i & 4) != 0 ? z : 0);
  }
  mesh.triangles = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                    {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
  return mesh;
}

}  // namespace celadon::testing
