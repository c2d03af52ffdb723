#pragma once
// Calibration targets in the picture under room light, sharper than what is about them.

#include <functional>
#include <vector>

#include "sim/lens_blur.h"
#include "sim/optics.h"
#include "sim/scene.h"

namespace celadon::sim {

/// Draws what is printed within the outlines of a scene: sampled kSub times along each side of a pixel, blurred by the
/// lens.
class PrintPainter {
 public:
  explicit PrintPainter(const OpticsConfig& config);

  /// @param pose_of_row where the table is while a row is exposed
  /// @param brightness  of a printed place under room light
  /// @param levels      height x width, painted over
  void paint(const Scene& scene, const VirtualCamera& camera, const std::function<TablePose(int)>& pose_of_row,
             const std::function<double(const Hit&)>& brightness, std::vector<float>& levels);

 private:
  static constexpr int kSub = 3;
  Patch patch_of(const std::vector<Eigen::Vector3d>& outline, const VirtualCamera& camera,
                 const std::function<TablePose(int)>& pose_of_row) const;

  int width_, height_;
  LensBlur blur_;
  std::vector<float> fine_;  ///< samples of a patch
};

}  // namespace celadon::sim
