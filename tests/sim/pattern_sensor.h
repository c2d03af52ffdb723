#pragma once
// A sensor for tests: another pattern in every picture, all at once.

#include <vector>

#include "sim/camera_sensor.h"

namespace celadon::sim {

class PatternSensor : public CameraSensor {
 public:
  PatternSensor(int width_px, int height_px) : width_(width_px), height_(height_px) {}

  /// Level of a pixel in picture `number`.
  static std::uint8_t level(int number, int x, int y) { return static_cast<std::uint8_t>(number + 3 * x + 5 * y); }

  /// U (even) or V (odd) of a coloured picture: wide fields.
  static std::uint8_t chroma(int i) { return static_cast<std::uint8_t>((i % 2 == 0 ? 90 : 150) + i / 320 * 5); }

  int width_px() const override { return width_; }
  int height_px() const override { return height_; }
  std::int64_t period_ns() const override { return 33'333'300; }
  std::int64_t longest_exposure_ns() const override { return 204'700'000; }
  bool start() override {
    ++starts;
    return !busy;
  }
  void stop() override { ++stops; }
  bool begin_picture() override { return !dark; }
  Picture picture() override {
    if (waits-- > 0) return {};
    luma_.resize(static_cast<std::size_t>(width_ * height_));
    for (int y = 0; y < height_; ++y) {
      for (int x = 0; x < width_; ++x) luma_[static_cast<std::size_t>(y * width_ + x)] = level(number, x, y);
    }
    if (!coloured) return {luma_, corrupt};
    chroma_.resize(luma_.size());
    for (std::size_t i = 0; i < chroma_.size(); ++i) chroma_[i] = chroma(static_cast<int>(i));
    return {luma_, corrupt, chroma_};
  }
  void end_picture() override { ++number; }
  void set_exposure(std::int64_t ns) override { exposure_ns = ns; }

  int number = 0, starts = 0, stops = 0, waits = 0;
  bool busy = false, dark = false, corrupt = false, coloured = false;
  std::int64_t exposure_ns = 0;

 private:
  int width_, height_;
  std::vector<std::uint8_t> luma_, chroma_;
};

}  // namespace celadon::sim
