#pragma once
// Pictures of a platter with fiducials by the virtual scanner, whose print, projection and truth are its own.

#include <cmath>
#include <cstdint>
#include <memory>
#include <numbers>
#include <stdexcept>
#include <string>
#include <vector>

#include "acquisition/calibration.h"
#include "acquisition/frame.h"
#include "sim/device_model.h"
#include "sim/renderer.h"

namespace celadon::testing {

class RimCamera {
 public:
  static constexpr int kWidth = 1280, kHeight = 1024;

  /// @param light  room light; 9 makes 200 levels on paper
  explicit RimCamera(const std::string& scene = "cylinder", double light = 9, int tags = 12) {
    device_.optics = sim::default_optics(kWidth, kHeight, 0.3, 0.002);
    device_.rim_tags = tags;
    auto made = sim::Scene::make(scene);
    if (!made) throw std::invalid_argument(made.error());
    made->set_rim_tags(tags);
    renderer_ = std::make_unique<sim::Renderer>(*made, device_.optics);
    exposure_.exposure_ns = 4'000'000;
    exposure_.ambient_factor = light;
    mode_.width_px = kWidth;
    mode_.height_px = kHeight;
    mode_.stride_bytes = kWidth;
  }

  Calibration truth() const { return sim::DeviceModel(device_).calibration(); }
  const CameraMode& mode() const { return mode_; }
  const std::vector<std::uint8_t>& shoot(double angle_rad, std::uint64_t seed, bool laser = false) {
    exposure_.seed = seed;
    exposure_.motion.samples.assign(10, {angle_rad, 0, laser ? 1. : 0.});
    bytes_.resize(std::size_t{kWidth} * kHeight);
    renderer_->render(exposure_, bytes_, kWidth);
    return bytes_;
  }
  /// Rounded mean of pictures with the laser off, as a scan makes its background.
  std::vector<std::uint8_t> mean_dark(int frames) {
    std::vector<int> sum(std::size_t{kWidth} * kHeight);
    for (int k = 0; k < frames; ++k) {
      const std::vector<std::uint8_t>& dark = shoot(0, static_cast<std::uint64_t>(1 + k));
      for (std::size_t i = 0; i < sum.size(); ++i) sum[i] += dark[i];
    }
    std::vector<std::uint8_t> mean;
    for (const int total : sum) mean.push_back(static_cast<std::uint8_t>((total + frames / 2) / frames));
    return mean;
  }

 private:
  sim::DeviceConfig device_;
  std::unique_ptr<sim::Renderer> renderer_;
  sim::Exposure exposure_;
  CameraMode mode_;
  std::vector<std::uint8_t> bytes_;
};

}  // namespace celadon::testing
