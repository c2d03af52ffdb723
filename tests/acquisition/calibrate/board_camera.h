#pragma once
// Pictures of boards by the virtual scanner, whose print, projection and truth are its own.

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "acquisition/calibrate/board_finder.h"
#include "sim/board_body.h"
#include "sim/device_truth.h"
#include "sim/renderer.h"

namespace celadon::testing {

class BoardCamera {
 public:
  static constexpr int kWidth = 1280, kHeight = 1024;

  /// The laser is off; room light of 200 levels on paper.
  explicit BoardCamera(const std::string& scene, double light = 9, double blur_px = 0.6, double noise = 1,
                       const sim::PrintErrors& print = {}) {
    device_.optics = sim::default_optics(kWidth, kHeight, 0.3, 0.002);
    device_.optics.blur_px = blur_px;
    device_.optics.noise.read_levels *= static_cast<float>(noise);
    device_.optics.noise.electrons_per_level /= static_cast<float>(noise * noise);
    const auto made = sim::Scene::make(scene, print);
    if (!made) throw std::invalid_argument(made.error());
    for (const auto& corner : sim::corners_of(device_, *made, {})) {
      truth_[corner["corner"].get<int>()] = {corner["x_px"].get<double>(), corner["y_px"].get<double>()};
    }
    renderer_ = std::make_unique<sim::Renderer>(*made, device_.optics);
    exposure_.exposure_ns = 4'000'000;
    exposure_.ambient_factor = light;
    exposure_.motion.samples.assign(10, {0, 0, 0});
  }

  std::vector<std::uint8_t> shoot(std::uint64_t seed) {
    exposure_.seed = seed;
    std::vector<std::uint8_t> bytes(std::size_t{kWidth} * kHeight);
    renderer_->render(exposure_, bytes, kWidth);
    return bytes;
  }
  /// Of the corners in the picture, by id.
  const std::map<int, Eigen::Vector2d>& truth() const { return truth_; }

 private:
  sim::DeviceConfig device_;
  std::map<int, Eigen::Vector2d> truth_;
  std::unique_ptr<sim::Renderer> renderer_;
  sim::Exposure exposure_;
};

/// Found less true.
struct CornerErrors {
  int count = 0;
  double rms_px = 0, worst_px = 0;  ///< rms of a coordinate; worst distance
  Eigen::Vector2d mean_px = Eigen::Vector2d::Zero();

  CornerErrors(const std::vector<SeenCorner>& found, const std::map<int, Eigen::Vector2d>& truth) {
    double squares = 0;
    for (const SeenCorner& corner : found) {
      const auto at = truth.find(corner.id);
      const Eigen::Vector2d error = at == truth.end() ? Eigen::Vector2d(1e6, 1e6) : corner.p_px - at->second;
      squares += error.squaredNorm();
      worst_px = std::max(worst_px, error.norm());
      mean_px += error;
      ++count;
    }
    rms_px = std::sqrt(squares / std::max(1, 2 * count));
    mean_px /= std::max(1, count);
  }
};

}  // namespace celadon::testing
