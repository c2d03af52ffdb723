#pragma once
// A body bounded by triangles, from an STL or PLY file.

#include <memory>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/files/mesh_files.h"
#include "sim/triangle_tree.h"

namespace celadon::sim {

/// The faces are flat, as the file has them. Faces of one smooth surface are those reached over edges that bend by less
/// than 8 degrees.
class MeshBody final : public Body {
 public:
  /// A file in millimetres: its z axis becomes the object's, its lowest point rests on the platter. If its signed
  /// volume is negative all faces are turned around. Errors: one sentence.
  static tl::expected<std::shared_ptr<const MeshBody>, std::string> read(const std::string& file);
  /// @pre one triangle or more
  explicit MeshBody(TriangleMesh mesh);

  double height_mm() const override { return height_; }
  double r_max_mm() const override { return r_max_; }
  bool of_revolution() const override { return false; }
  bool has_edges() const override { return true; }
  std::optional<BodyHit> intersect(const Ray& ray_O, double t_min, double t_max) const override;
  /// Walks from face to face within one smooth surface.
  std::optional<BodyHit> refine(const Ray& ray_O, double t_near, int facet) const override;
  /// Of the outermost point.
  double reach_mm(const Ray& from_axis_O) const override;

 private:
  BodyHit hit_at(double t, int triangle) const;

  std::unique_ptr<const TriangleTree> tree_;
  std::vector<std::array<std::int32_t, 3>> neighbours_;  ///< across the edges opposite to the corners; -1: none
  std::vector<std::int32_t> surface_;
  double height_ = 0, r_max_ = 0;
};

}  // namespace celadon::sim
