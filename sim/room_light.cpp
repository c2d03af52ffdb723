#include "sim/room_light.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/rotation.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr double kCell_rad = 5 * std::numbers::pi / 180;
constexpr int kBlock = 8;  // room light is rendered on every eighth pixel

}  // namespace

RoomLight::RoomLight(const OpticsConfig& config)
    : config_(config),
      levels_(static_cast<std::size_t>(config.camera.width_px) * static_cast<std::size_t>(config.camera.height_px)) {}

// Room light: a gradient over the background, and the object and platter shaded by a broad lamp above the camera.
void RoomLight::update(const Scene& scene, const VirtualCamera& camera, double angle_rad) {
  const long cell = scene.turns_invisibly() ? 0 : std::lround(angle_rad / kCell_rad);
  if (ready_ && cell == cell_) return;
  cell_ = cell;
  const double angle = static_cast<double>(cell) * kCell_rad, c = std::cos(angle), s = std::sin(angle);
  const int width = config_.camera.width_px, height = config_.camera.height_px;
  const int columns = (width + kBlock - 1) / kBlock + 1, rows = (height + kBlock - 1) / kBlock + 1;
  const Vector3d lamp = Vector3d(0.35, 0.55, 0.75).normalized(), centre_T = turned(camera.centre_W(), c, -s);
  if (!ready_) {
    rays_W_.clear();
    for (int j = 0; j < rows; ++j) {
      for (int i = 0; i < columns; ++i) rays_W_.push_back(camera.ray_W(i * kBlock, j * kBlock));
    }
  }
  ready_ = true;
  std::vector<float> grid(static_cast<std::size_t>(columns * rows));
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const double fx = std::min(1.0, static_cast<double>(i * kBlock) / width),
                   fy = std::min(1.0, static_cast<double>(j * kBlock) / height);
      double level = config_.ambient_low + (config_.ambient_high - config_.ambient_low) * (0.7 * fx + 0.3 * (1 - fy)) +
                     0.08 * config_.ambient_high * std::sin(9 * fx + 1) * std::sin(6 * fy);
      const Vector3d d_T = turned(rays_W_[static_cast<std::size_t>(j * columns + i)], c, -s);
      if (const auto hit = scene.intersect({centre_T, d_T})) {
        const double lit = std::max(0.0, hit->normal.dot(turned(lamp, c, -s)));
        const double albedo = hit->material == Material::platter ? config_.platter_albedo : 1;
        level = config_.object_ambient * albedo * (0.3 + 0.7 * lit);
      }
      grid[static_cast<std::size_t>(j * columns + i)] = static_cast<float>(std::max(0.0, level));
    }
  }
  // The lamp is broad and the room out of focus: edges of room light are soft.
  std::vector<float> soft = grid;
  for (int j = 1; j + 1 < rows; ++j) {
    for (int i = 1; i + 1 < columns; ++i) {
      const float* g = &grid[static_cast<std::size_t>(j * columns + i)];
      soft[static_cast<std::size_t>(j * columns + i)] =
          0.25F * g[0] + 0.125F * (g[-1] + g[1] + g[-columns] + g[columns]) +
          0.0625F * (g[-columns - 1] + g[-columns + 1] + g[columns - 1] + g[columns + 1]);
    }
  }
  for (int y = 0; y < height; ++y) {
    const int j = y / kBlock;
    const float fy = static_cast<float>(y % kBlock) / kBlock;
    const float *above = &soft[static_cast<std::size_t>(j * columns)], *below = above + columns;
    float* out = &levels_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width)];
    for (int x = 0; x < width; ++x) {
      const int i = x / kBlock;
      const float fx = static_cast<float>(x % kBlock) / kBlock;
      const float a = above[i] + fx * (above[i + 1] - above[i]), b = below[i] + fx * (below[i + 1] - below[i]);
      out[x] = a + fy * (b - a);
    }
  }
}

}  // namespace celadon::sim
