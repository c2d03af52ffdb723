#include "sim/texture_painter.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <optional>

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr int kTextureCell = 4;        // pixels: what is thinner may be missed
constexpr double kSmoothDepth = 0.01;  // of the depth, over a cell: no fold of the surface lies within

/// Rays and what they meet at the corners of one cell, the upper two first.
struct Cell {
  std::array<const Vector3d*, 4> ray_T;
  std::array<const std::optional<Hit>*, 4> hit;

  static bool is_object(const std::optional<Hit>& hit) { return hit && hit->material == Material::object; }
  bool without_object() const {
    return std::none_of(hit.begin(), hit.end(), [](const auto* h) { return is_object(*h); });
  }
  /// One smooth part of the object and nothing else.
  bool smooth() const {
    if (!std::all_of(hit.begin(), hit.end(), [](const auto* h) { return is_object(*h); })) return false;
    const auto [least, most] =
        std::minmax_element(hit.begin(), hit.end(), [](const auto* a, const auto* b) { return (*a)->t < (*b)->t; });
    return (**most)->t - (**least)->t < kSmoothDepth * (**least)->t &&
           std::all_of(hit.begin(), hit.end(), [&](const auto* h) { return (*h)->surface == (*hit[0])->surface; });
  }
  /// Rays bend by less than a thousandth of a pixel within a cell.
  Vector3d ray(double u, double v) const {
    return (1 - v) * ((1 - u) * *ray_T[0] + u * *ray_T[1]) + v * ((1 - u) * *ray_T[2] + u * *ray_T[3]);
  }
  double t(double u, double v) const {
    return (1 - v) * ((1 - u) * (*hit[0])->t + u * (*hit[1])->t) + v * ((1 - u) * (*hit[2])->t + u * (*hit[3])->t);
  }
};

}  // namespace

TexturePainter::TexturePainter(const OpticsConfig& config)
    : width_(config.camera.width_px), height_(config.camera.height_px), blur_(config.blur_px, 1) {}

// About the upright cylinder that holds the object.
Patch TexturePainter::patch_of(const Scene& scene, const VirtualCamera& camera, const TablePose& pose) const {
  constexpr int kAround = 16;
  const double r = scene.r_max_mm() / std::cos(std::numbers::pi / kAround);
  Eigen::Vector2d low(width_, height_), high(0, 0);
  for (int k = 0; k < kAround; ++k) {
    const double a = 2 * std::numbers::pi * k / kAround;
    for (const double z : {scene.z_min_mm(), scene.z_max_mm()}) {
      const Eigen::Vector2d pixel = camera.project(pose.to_head(Vector3d(r * std::cos(a), r * std::sin(a), z)));
      low = low.cwiseMin(pixel);
      high = high.cwiseMax(pixel);
    }
  }
  const int margin = blur_.margin_px();
  const auto inside = [&](double value, int most) { return static_cast<int>(std::clamp(value, 0., double(most))); };
  return {inside(std::floor(low.x()) - margin, width_), inside(std::floor(low.y()) - margin, height_),
          inside(std::ceil(high.x()) + margin + 1, width_), inside(std::ceil(high.y()) + margin + 1, height_)};
}

void TexturePainter::paint(const Scene& scene, const VirtualCamera& camera, const TablePose& pose, const Look& look,
                           std::span<std::vector<float>> planes) {
  const int columns = (width_ + kTextureCell - 1) / kTextureCell + 1,
            rows = (height_ + kTextureCell - 1) / kTextureCell + 1;
  if (rays_H_.empty()) {
    for (int j = 0; j < rows; ++j) {
      for (int i = 0; i < columns; ++i) rays_H_.push_back(camera.ray_W(i * kTextureCell, j * kTextureCell));
    }
  }
  Patch patch = patch_of(scene, camera, pose);
  patch.x0 -= patch.x0 % kTextureCell;
  patch.y0 -= patch.y0 % kTextureCell;
  if (patch.empty()) return;
  const int i0 = patch.x0 / kTextureCell, j0 = patch.y0 / kTextureCell;
  const int i1 = (patch.x1 + kTextureCell - 1) / kTextureCell, j1 = (patch.y1 + kTextureCell - 1) / kTextureCell;
  const Vector3d centre_T = pose.to_table(camera.centre_W());
  const auto wide = static_cast<std::size_t>(i1 - i0 + 1);
  std::vector<Vector3d> rays_T;
  std::vector<std::optional<Hit>> hits;
  for (int j = j0; j <= j1; ++j) {
    for (int i = i0; i <= i1; ++i) {
      rays_T.push_back(pose.direction_to_table(rays_H_[static_cast<std::size_t>(j * columns + i)]));
      hits.push_back(scene.intersect({centre_T, rays_T.back()}));
    }
  }
  for (std::size_t c = 0; c < planes.size(); ++c)
    seen_[c].resize(static_cast<std::size_t>(patch.width()) * static_cast<std::size_t>(patch.height()));
  for (int y = patch.y0; y < patch.y1; ++y) {
    for (int x = patch.x0; x < patch.x1; ++x) {
      const auto from = static_cast<std::size_t>(y * width_ + x),
                 to = static_cast<std::size_t>((y - patch.y0) * patch.width() + x - patch.x0);
      const std::size_t at =
          static_cast<std::size_t>(y / kTextureCell - j0) * wide + static_cast<std::size_t>(x / kTextureCell - i0);
      const Cell cell{{&rays_T[at], &rays_T[at + 1], &rays_T[at + wide], &rays_T[at + wide + 1]},
                      {&hits[at], &hits[at + 1], &hits[at + wide], &hits[at + wide + 1]}};
      for (std::size_t c = 0; c < planes.size(); ++c) seen_[c][to] = planes[c][from];
      if (cell.without_object()) continue;
      const double u = static_cast<double>(x % kTextureCell) / kTextureCell,
                   v = static_cast<double>(y % kTextureCell) / kTextureCell;
      const Ray ray{centre_T, cell.ray(u, v)};
      std::optional<Hit> hit;
      if (cell.smooth()) hit = scene.refine(ray, cell.t(u, v), (*cell.hit[0])->facet);
      if (!hit) hit = scene.intersect(ray);
      if (!Cell::is_object(hit)) continue;
      const std::array<float, 3> level = look(*hit);
      for (std::size_t c = 0; c < planes.size(); ++c) seen_[c][to] = level[c];
    }
  }
  for (std::size_t c = 0; c < planes.size(); ++c) blur_.apply(seen_[c], patch, width_, planes[c]);
}

}  // namespace celadon::sim
