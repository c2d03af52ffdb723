#pragma once
// A textured or coloured object in the picture under room light: each pixel's ray meets the body.

#include <array>
#include <functional>
#include <span>
#include <vector>

#include "sim/lens_blur.h"
#include "sim/optics.h"
#include "sim/scene.h"

namespace celadon::sim {

class TexturePainter {
 public:
  explicit TexturePainter(const OpticsConfig& config);

  /// Levels of a place in each plane.
  using Look = std::function<std::array<float, 3>(const Hit&)>;
  /// @param look    how a place of the object looks under room light
  /// @param planes  one or three, height x width each, painted over where the object is seen
  void paint(const Scene& scene, const VirtualCamera& camera, const TablePose& pose, const Look& look,
             std::span<std::vector<float>> planes);
  /// The camera was moved.
  void forget() { rays_H_.clear(); }

 private:
  Patch patch_of(const Scene& scene, const VirtualCamera& camera, const TablePose& pose) const;

  int width_, height_;
  LensBlur blur_;
  std::vector<Eigen::Vector3d> rays_H_;     ///< at the corners of cells, over the whole picture
  std::array<std::vector<float>, 3> seen_;  ///< of the patch in each plane, before the lens
};

}  // namespace celadon::sim
