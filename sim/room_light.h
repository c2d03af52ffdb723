#pragma once
// The picture without the laser: background, object and platter under room light.

#include <array>
#include <optional>
#include <vector>

#include "sim/exposure.h"
#include "sim/optics.h"
#include "sim/print_painter.h"
#include "sim/scene.h"
#include "sim/texture_painter.h"

namespace celadon::sim {

class RoomLight {
 public:
  explicit RoomLight(const OpticsConfig& config);

  /// Makes levels() those of the middle of an exposure: in steps of five degrees of the table, of a degree of the head,
  /// of a millimetre of the lift; with a textured object exactly there, and calibration targets in each row as it is
  /// exposed.
  void update(const Scene& scene, const VirtualCamera& camera, const Exposure& exposure);
  /// The object or the camera was moved.
  void forget() {
    ready_ = false;
    textures_.forget();
  }
  /// Height x width, at the reference exposure, as a grey camera sees it.
  const std::vector<float>& levels() const { return levels_; }
  /// The same of red (0), green (1) or blue (2) of white light: those of levels() where nothing is coloured.
  const std::vector<float>& levels(std::size_t channel) const { return coloured_ ? colours_[channel] : levels_; }

 private:
  double brightness(const Hit& hit, const Eigen::Vector3d& lamp_T) const;
  void paint_colours(const Scene& scene, const VirtualCamera& camera, const TablePose& pose,
                     const Eigen::Vector3d& lamp_T);
  void shade(const Scene& scene, const VirtualCamera& camera, const Posture& posture);

  OpticsConfig config_;
  std::vector<float> shaded_, levels_;  ///< without and with texture, colours and prints
  std::array<std::vector<float>, 3> colours_;
  bool coloured_ = false;
  TexturePainter textures_;
  PrintPainter prints_;
  std::vector<Eigen::Vector3d> rays_H_;  ///< of the pixels that are looked at
  Posture shaded_at_;
  std::optional<Posture> painted_at_;  ///< nullopt: its rows are of different postures
  bool ready_ = false;
};

}  // namespace celadon::sim
