#pragma once
// From scene, laser sheet and camera to the bytes of a frame. README.md, "How a frame is made".

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "sim/exposure.h"
#include "sim/laser_fan.h"
#include "sim/line_picture.h"
#include "sim/optics.h"
#include "sim/random.h"
#include "sim/room_light.h"
#include "sim/scene.h"

namespace celadon::sim {

/// Renders frames; a pure function of the exposure. Owns scratch memory: one thread at a time.
class Renderer {
 public:
  Renderer(Scene scene, const OpticsConfig& config);

  /// Fills `out` (height rows of stride_bytes).
  /// @pre out.size() >= height * stride_bytes, stride_bytes >= width * bytes per pixel
  void render(const Exposure& exposure, std::span<std::uint8_t> out, std::size_t stride_bytes);
  /// Mean brightness of the laser line alone, in levels over the background, without speckle and noise: for tests.
  void render_line(const Exposure& exposure, std::vector<float>& levels);

  /// Another object.
  void put(const Scene& scene);
  /// Another pose of the object on the table, or a camera that was turned about its own vertical.
  void place(const ObjectPose& pose, double camera_turn_rad);

  const Scene& scene() const { return scene_; }
  const OpticsConfig& config() const { return config_; }
  const VirtualCamera& camera() const { return camera_; }

 private:
  void aim_lasers();
  void draw_lasers(const Exposure& exposure);
  struct Line;
  void draw_line(Line& line, int laser, const Exposure& exposure);
  void speckle_row(const RandomKey& key, int row, int from, int to);

  Scene scene_;
  double camera_turn_rad_ = 0;
  OpticsConfig config_;
  VirtualCamera camera_;
  struct Line {
    LaserFan fan;
    Strand strand;
    bool is_current = false;  ///< of a scene that looks the same at every angle
    Posture posture{};        ///< of that strand
  };
  std::vector<Line> lines_;  ///< a laser each
  Strand moved_;
  LinePicture picture_;
  RoomLight room_;
  std::vector<float> mean_, speckle_, white_;
  std::array<std::vector<std::uint8_t>, 3> colour_;
};

}  // namespace celadon::sim
