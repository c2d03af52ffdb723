#pragma once
// First intersections of rays with triangles, by a bounding volume hierarchy built by the surface area heuristic.

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "sim/body.h"

namespace celadon::sim {

/// A triangle prepared for intersection: points are p + u a + v b with u, v, 1 - u - v >= 0.
struct TreeTriangle {
  Eigen::Vector3d p, a, b;

  /// t, u, v of the ray's crossing with the plane; nothing if it is parallel.
  std::optional<Eigen::Vector3d> plane_crossing(const Ray& ray) const;
};

class TriangleTree {
 public:
  /// @pre one triangle or more
  explicit TriangleTree(std::vector<TreeTriangle> triangles);

  struct Found {
    double t = 0;
    int triangle = 0;  ///< as given to the constructor
  };
  /// The nearest crossing with t in (t_min, t_max), from either side. Edges belong to both triangles, so that no ray
  /// slips between them.
  std::optional<Found> first(const Ray& ray, double t_min, double t_max) const;
  const TreeTriangle& triangle(int index) const { return triangles_[static_cast<std::size_t>(index)]; }

 private:
  struct Node {
    std::array<float, 3> low, high;
    std::int32_t begin;  ///< leaf: in order_; else: the right child, the left one follows its parent
    std::int32_t count;  ///< 0: not a leaf
  };
  std::int32_t build(std::int32_t begin, std::int32_t end, const std::vector<Eigen::Vector3d>& centres);

  std::vector<TreeTriangle> triangles_;
  std::vector<TreeTriangle> packed_;  ///< in the order of the leaves
  std::vector<std::int32_t> order_;
  std::vector<Node> nodes_;
};

}  // namespace celadon::sim
