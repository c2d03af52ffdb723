#pragma once
// Frames of a laser line with known sub-pixel truth: Gaussian cross section, correlated speckle, shot and read noise,
// ambient light with gradient and texture, saturated stretches, gaps, a secondary reflection. Seeded.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <random>
#include <vector>

#include "acquisition/frame.h"

namespace celadon::synthetic {

enum class RowKind : std::uint8_t { none, line, saturated };

/// Light and noise of a scene, grey levels.
struct Scene {
  double amplitude = 110, ambient_low = 15, ambient_high = 45, texture = 3;
  double speckle_contrast = 0.25, read_noise = 1.5, electrons_per_level = 40;
  bool correlated_speckle = true, gaps = true, saturation = true, reflection = true;
};

inline Scene good_scene() {
  return {.amplitude = 170,
          .ambient_low = 12,
          .ambient_high = 25,
          .texture = 1,
          .speckle_contrast = 0.10,
          .read_noise = 1.0};
}
inline Scene nominal_scene() {
  return {};
}
inline Scene hard_scene() {
  return {.amplitude = 40,
          .ambient_low = 30,
          .ambient_high = 80,
          .texture = 8,
          .speckle_contrast = 0.35,
          .read_noise = 2.0};
}

/// Sum of the autocorrelation of the speckle below along a row: (0.2 + 0.6 + 0.2)^2 / (0.04 + 0.36 + 0.04).
inline constexpr double kSpeckleExtentPx = 1 / 0.44;

/// The line in each row.
struct Truth {
  std::vector<double> center_px, width_px, amplitude;
  std::vector<RowKind> kind;
};

struct Picture {
  int width = 0, height = 0;
  std::vector<std::uint8_t> on, off;  ///< grey, no padding
  Truth truth;
};

/// Standard normal and unit-mean gamma values, drawn by index from tables: a million pixels in a few milliseconds.
class Noise {
 public:
  Noise(std::uint64_t seed, double speckle_contrast) : state_(seed * 0x9E3779B97F4A7C15ull + 0x1234567ull) {
    std::mt19937_64 generator(seed ^ 0x5DEECE66Dull);
    std::normal_distribution<float> normal;
    normal_.resize(kSize);
    for (float& value : normal_) value = normal(generator);
    speckle_.assign(kSize, 1.f);
    if (speckle_contrast > 0) {
      const double variance = speckle_contrast * speckle_contrast;
      std::gamma_distribution<double> gamma(1 / variance, variance);
      for (float& value : speckle_) value = static_cast<float>(gamma(generator));
    }
  }
  double normal() { return static_cast<double>(normal_[next()]); }
  double speckle() { return static_cast<double>(speckle_[next()]); }

 private:
  static constexpr std::size_t kSize = std::size_t{1} << 16;
  std::size_t next() {
    state_ ^= state_ << 13;
    state_ ^= state_ >> 7;
    state_ ^= state_ << 17;
    return static_cast<std::size_t>(state_ >> 40) & (kSize - 1);
  }
  std::uint64_t state_;
  std::vector<float> normal_, speckle_;
};

/// Unit-mean speckle over the frame, with its pixels' contrast kept when they are correlated.
inline std::vector<float> speckle_field(int width, int height, bool correlated, Noise& noise) {
  const auto w = static_cast<std::size_t>(width), h = static_cast<std::size_t>(height);
  std::vector<float> raw(w * h);
  for (float& value : raw) value = static_cast<float>(noise.speckle() - 1);
  if (correlated) {
    std::vector<float> along(raw.size());
    for (std::size_t y = 0; y < h; ++y) {
      for (std::size_t x = 0; x < w; ++x) {
        const float* row = &raw[y * w];
        along[y * w + x] = 0.6f * row[x] + 0.2f * (row[x > 0 ? x - 1 : 0] + row[std::min(x + 1, w - 1)]);
      }
    }
    for (std::size_t y = 0; y < h; ++y) {
      for (std::size_t x = 0; x < w; ++x) {
        const float above = along[(y > 0 ? y - 1 : 0) * w + x], below = along[std::min(y + 1, h - 1) * w + x];
        raw[y * w + x] = (0.6f * along[y * w + x] + 0.2f * (above + below)) / 0.44f;
      }
    }
  }
  for (float& value : raw) value = std::max(0.f, 1 + value);
  return raw;
}

/// Light that is not the line's, by (column, row).
using Light = std::function<double(int, int)>;

/// Draws `truth` over `ambient`; `reflectance` scales the laser's light by (column, row).
inline Picture draw(int width, int height, const Truth& truth, const Scene& scene, std::uint64_t seed,
                    const Light& ambient, const Light& extra_laser = nullptr, const Light& reflectance = nullptr) {
  Noise noise(seed, scene.speckle_contrast);
  const std::vector<float> speckle =
      scene.speckle_contrast > 0 ? speckle_field(width, height, scene.correlated_speckle, noise) : std::vector<float>();
  Picture picture{width, height, {}, {}, truth};
  const std::size_t size = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  picture.on.resize(size);
  picture.off.resize(size);
  const auto digitise = [&](double light) {
    const double deviation = std::sqrt(light / scene.electrons_per_level + scene.read_noise * scene.read_noise);
    return static_cast<std::uint8_t>(std::clamp(light + deviation * noise.normal() + 0.5, 0.0, 255.0));
  };
  for (int y = 0; y < height; ++y) {
    const auto row = static_cast<std::size_t>(y);
    for (int x = 0; x < width; ++x) {
      const std::size_t i = row * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
      double laser = 0;
      if (truth.kind[row] != RowKind::none) {
        const double u = (x - truth.center_px[row]) / truth.width_px[row];
        if (std::abs(u) < 6) laser = truth.amplitude[row] * std::exp(-0.5 * u * u);
      }
      if (extra_laser) laser += extra_laser(x, y);
      if (reflectance) laser *= reflectance(x, y);
      if (!speckle.empty()) laser *= static_cast<double>(speckle[i]);
      const double light = ambient(x, y);
      picture.on[i] = digitise(light + laser);
      picture.off[i] = digitise(light);
    }
  }
  return picture;
}

/// A winding line of changing width and brightness with gaps, saturation, texture and a reflection, as in a scan.
inline Picture scan_frame(int width, int height, const Scene& scene, std::uint64_t seed) {
  std::mt19937_64 generator(seed * 977 + 5);
  const auto uniform = [&](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(generator);
  };
  constexpr double kTurn = 6.283185307179586;
  const double p1 = uniform(0, kTurn), p2 = uniform(0, kTurn), p3 = uniform(0, kTurn), p4 = uniform(0, kTurn);
  const double start = uniform(0.42, 0.58) * width, scale = width / 1280.0;
  Truth truth;
  for (int y = 0; y < height; ++y) {
    const double f = static_cast<double>(y) / height;
    truth.center_px.push_back(start +
                              scale * (100 * std::sin(kTurn * 1.4 * f + p1) + 16 * std::sin(kTurn * 6.3 * f + p2)));
    truth.width_px.push_back(3 + std::sin(kTurn * 2.1 * f + p3));
    truth.amplitude.push_back(scene.amplitude * (0.65 + 0.35 * std::sin(kTurn * 3.7 * f + p4)));
    truth.kind.push_back(RowKind::line);
  }
  const auto stretch = [&](double share, auto&& change) {
    const int begin = static_cast<int>(uniform(0, 0.95) * height);
    const int end = std::min(height, begin + static_cast<int>(share * height));
    for (int y = begin; y < end; ++y) change(static_cast<std::size_t>(y));
  };
  for (int i = 0; i < 3 && scene.gaps; ++i) stretch(0.035, [&](std::size_t y) { truth.kind[y] = RowKind::none; });
  for (int i = 0; i < 2 && scene.saturation; ++i) {
    stretch(0.04, [&](std::size_t y) {
      if (truth.kind[y] == RowKind::none) return;
      truth.kind[y] = RowKind::saturated;
      truth.amplitude[y] = 450;
    });
  }
  const int reflected_from = static_cast<int>(uniform(0, 0.7) * height);
  const int reflected_to = reflected_from + static_cast<int>(0.28 * height);
  const double reflected_at = uniform(70, 160) * (uniform(0, 1) < 0.5 ? -1 : 1);
  const double texture_phase = uniform(0, kTurn);
  const auto ambient = [&, texture_phase](int x, int y) {
    return scene.ambient_low + (scene.ambient_high - scene.ambient_low) * (0.7 * x / width + 0.3 * y / height) +
           scene.texture * std::sin(x * 0.031 + texture_phase) * std::sin(y * 0.023) +
           scene.texture * 0.5 * std::sin(x * 0.11 + y * 0.07);
  };
  const auto reflection = [&](int x, int y) {
    const auto row = static_cast<std::size_t>(y);
    if (!scene.reflection || y < reflected_from || y >= reflected_to || truth.kind[row] == RowKind::none) return 0.0;
    const double u = (x - truth.center_px[row] - reflected_at) / 5;
    return std::abs(u) < 6 ? 0.25 * std::min(truth.amplitude[row], scene.amplitude) * std::exp(-0.5 * u * u) : 0.0;
  };
  return draw(width, height, truth, scene, seed, ambient, reflection);
}

/// A line x = start + slope * row of one width and amplitude over a constant background.
inline Picture straight_line(int width, int height, double start, double slope, double line_width, const Scene& scene,
                             std::uint64_t seed, const Light& reflectance = nullptr) {
  Truth truth;
  for (int y = 0; y < height; ++y) {
    truth.center_px.push_back(start + slope * y);
    truth.width_px.push_back(line_width);
    truth.amplitude.push_back(scene.amplitude);
    truth.kind.push_back(RowKind::line);
  }
  const double ambient = scene.ambient_low;
  return draw(
      width, height, truth, scene, seed, [ambient](int, int) { return ambient; }, nullptr, reflectance);
}

inline CameraMode mode_of(int width, int height, PixelFormat format = PixelFormat::grey8, std::size_t stride = 0) {
  CameraMode mode;
  mode.width_px = width;
  mode.height_px = height;
  mode.format = format;
  mode.stride_bytes = stride != 0 ? stride : static_cast<std::size_t>(width) * bytes_per_pixel(format);
  return mode;
}

/// Errors of extracted positions against the truth; an error over 1.5 px counts as an outlier.
struct Score {
  double square_sum = 0, error_sum = 0, pull_square_sum = 0;
  long inliers = 0, outliers = 0, rows = 0, missed = 0;

  void add(const Truth& truth, std::size_t row, double x_px, double sigma_px = 1) {
    const bool expected = truth.kind[row] != RowKind::none;
    rows += expected;
    if (x_px < 0) {
      missed += expected;
      return;
    }
    const double error = x_px - truth.center_px[row];
    if (!expected || std::abs(error) > 1.5) {
      ++outliers;
      return;
    }
    ++inliers;
    square_sum += error * error;
    error_sum += error;
    pull_square_sum += error * error / (sigma_px * sigma_px);
  }
  double rms() const { return std::sqrt(square_sum / static_cast<double>(std::max(inliers, 1L))); }
  double mean() const { return error_sum / static_cast<double>(std::max(inliers, 1L)); }
  /// Spread over stated spread: 1 when sigma_px is right.
  double pull() const { return std::sqrt(pull_square_sum / static_cast<double>(std::max(inliers, 1L))); }
  double outlier_percent() const {
    return 100.0 * static_cast<double>(outliers) / static_cast<double>(std::max(inliers + outliers, 1L));
  }
  double miss_percent() const { return 100.0 * static_cast<double>(missed) / static_cast<double>(std::max(rows, 1L)); }
};

}  // namespace celadon::synthetic
