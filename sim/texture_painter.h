#pragma once
// A textured object in the picture under room light: each pixel's ray meets the body.

#include <functional>
#include <vector>

#include "sim/lens_blur.h"
#include "sim/optics.h"
#include "sim/scene.h"

namespace celadon::sim {

class TexturePainter {
 public:
  explicit TexturePainter(const OpticsConfig& config);

  /// @param brightness  of a place under room light, without its albedo
  /// @param levels      height x width, painted over where the object is seen
  void paint(const Scene& scene, const VirtualCamera& camera, const TablePose& pose,
             const std::function<double(const Hit&)>& brightness, std::vector<float>& levels);
  /// The camera was moved.
  void forget() { rays_H_.clear(); }

 private:
  Patch patch_of(const Scene& scene, const VirtualCamera& camera, const TablePose& pose) const;

  int width_, height_;
  LensBlur blur_;
  std::vector<Eigen::Vector3d> rays_H_;  ///< at the corners of cells, over the whole picture
  std::vector<float> seen_;              ///< of the patch, before the lens
};

}  // namespace celadon::sim
