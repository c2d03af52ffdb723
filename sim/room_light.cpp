#include "sim/room_light.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <optional>

#include "sim/rotation.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr double kCell_rad = 5 * std::numbers::pi / 180;
constexpr double kHeadCell_rad = std::numbers::pi / 180, kLiftCell_mm = 1;
constexpr double kPrintedCell_rad = 1e-6, kPrintedCell_mm = 1e-4;
constexpr int kBlock = 8;  // room light is rendered on every eighth pixel

constexpr int kSub = 3;  // samples of a print along a pixel

// The lamp hangs in the room: it stays when the head turns.
Vector3d lamp_in_table(const Posture& posture) {
  return turned(Vector3d(0.35, 0.55, 0.75).normalized(), std::cos(posture.table_rad), -std::sin(posture.table_rad));
}

// In [-0.5, 0.5), evenly spread over any run of numbers: an edge along a row or a column of samples is met in all
// phases.
double strewn(int number) {
  const double at = number * 0.6180339887498949;
  return at - std::floor(at) - 0.5;
}

// Gaussian blur of one line of samples, `step` floats apart; beyond its ends it stays as it is there.
void blur(float* line, int count, std::ptrdiff_t step, const std::vector<float>& taps, std::vector<float>& copy) {
  const int half = static_cast<int>(taps.size()) / 2;
  copy.resize(static_cast<std::size_t>(count + 2 * half));
  for (int i = -half; i < count + half; ++i) {
    copy[static_cast<std::size_t>(i + half)] = line[std::clamp(i, 0, count - 1) * step];
  }
  for (int i = 0; i < count; ++i) {
    float sum = 0;
    for (std::size_t k = 0; k < taps.size(); ++k) sum += taps[k] * copy[static_cast<std::size_t>(i) + k];
    line[i * step] = sum;
  }
}

}  // namespace

RoomLight::RoomLight(const OpticsConfig& config)
    : config_(config),
      shaded_(static_cast<std::size_t>(config.camera.width_px) * static_cast<std::size_t>(config.camera.height_px)),
      levels_(shaded_.size()) {}

void RoomLight::update(const Scene& scene, const VirtualCamera& camera, const Posture& posture) {
  const bool plain = scene.printed().empty();
  const auto stepped = [](double value, double step) { return std::round(value / step) * step; };
  Posture exact, near;  // near: for what may be shown a little turned
  exact.elevation_rad = near.elevation_rad = stepped(posture.elevation_rad, plain ? kHeadCell_rad : kPrintedCell_rad);
  if (!scene.held()) exact.lift_mm = near.lift_mm = stepped(posture.lift_mm, plain ? kLiftCell_mm : kPrintedCell_mm);
  if (!scene.turns_invisibly()) {
    exact.table_rad = stepped(posture.table_rad, kPrintedCell_rad);
    near.table_rad = scene.object_is_printed() ? exact.table_rad : stepped(posture.table_rad, kCell_rad);
  }
  const bool shaded = ready_ && near == shaded_at_;
  if (!shaded) shade(scene, camera, near);
  if (shaded && (plain || exact == printed_at_)) return;
  levels_ = shaded_;
  print(scene, camera, exact);
  ready_ = true;
  shaded_at_ = near;
  printed_at_ = exact;
}

// Room light: a gradient over the background, and the object and platter shaded by a broad lamp above the camera.
void RoomLight::shade(const Scene& scene, const VirtualCamera& camera, const Posture& shown) {
  const TablePose pose = scene.table_pose(shown, {}, config_.axes);
  const int width = config_.camera.width_px, height = config_.camera.height_px;
  const int columns = (width + kBlock - 1) / kBlock + 1, rows = (height + kBlock - 1) / kBlock + 1;
  const Vector3d lamp_T = lamp_in_table(shown), centre_T = pose.to_table(camera.centre_W());
  if (!ready_) {
    rays_H_.clear();
    for (int j = 0; j < rows; ++j) {
      for (int i = 0; i < columns; ++i) rays_H_.push_back(camera.ray_W(i * kBlock, j * kBlock));
    }
  }
  std::vector<float> grid(static_cast<std::size_t>(columns * rows));
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const double fx = std::min(1.0, static_cast<double>(i * kBlock) / width),
                   fy = std::min(1.0, static_cast<double>(j * kBlock) / height);
      double level = config_.ambient_low + (config_.ambient_high - config_.ambient_low) * (0.7 * fx + 0.3 * (1 - fy)) +
                     0.08 * config_.ambient_high * std::sin(9 * fx + 1) * std::sin(6 * fy);
      const Vector3d d_T = pose.direction_to_table(rays_H_[static_cast<std::size_t>(j * columns + i)]);
      if (auto hit = scene.intersect({centre_T, d_T})) {
        hit->print = 0;  // drawn afterwards
        level = brightness(*hit, lamp_T);
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
    float* out = &shaded_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width)];
    for (int x = 0; x < width; ++x) {
      const int i = x / kBlock;
      const float fx = static_cast<float>(x % kBlock) / kBlock;
      const float a = above[i] + fx * (above[i + 1] - above[i]), b = below[i] + fx * (below[i + 1] - below[i]);
      out[x] = a + fy * (b - a);
    }
  }
}

double RoomLight::brightness(const Hit& hit, const Vector3d& lamp_T) const {
  const double lit = std::max(0.0, hit.normal.dot(lamp_T));
  const double albedo = hit.print > 0 ? hit.print : hit.material == Material::platter ? config_.platter_albedo : 1;
  return config_.object_ambient * albedo * (0.3 + 0.7 * lit);
}

// Prints again, sharper: sampled kSub times along each side of a pixel where an outline lies, blurred by the lens.
void RoomLight::print(const Scene& scene, const VirtualCamera& camera, const Posture& posture) {
  const int width = config_.camera.width_px, height = config_.camera.height_px;
  const int margin = static_cast<int>(std::ceil(4 * config_.blur_px)) + 1;
  const double sigma = std::max(config_.blur_px, 0.1) * kSub;
  const TablePose pose = scene.table_pose(posture, {}, config_.axes);
  const Vector3d lamp_T = lamp_in_table(posture), centre_T = pose.to_table(camera.centre_W());
  std::vector<float> taps(2 * static_cast<std::size_t>(std::ceil(4 * sigma)) + 1), copy;
  float total = 0;
  for (std::size_t k = 0; k < taps.size(); ++k) {
    const double u = static_cast<double>(k) - static_cast<double>(taps.size() / 2);
    taps[k] = static_cast<float>(std::exp(-u * u / (2 * sigma * sigma)));
    total += taps[k];
  }
  for (float& tap : taps) tap /= total;
  for (const auto& outline : scene.printed()) {
    Eigen::Vector2d low(width, height), high(0, 0);
    for (const Vector3d& p : outline) {
      const Eigen::Vector2d pixel = camera.project(pose.to_head(p));
      low = low.cwiseMin(pixel);
      high = high.cwiseMax(pixel);
    }
    const int x0 = std::max(0, static_cast<int>(low.x()) - margin),
              y0 = std::max(0, static_cast<int>(low.y()) - margin);
    const int x1 = std::min(width, static_cast<int>(high.x()) + margin + 1),
              y1 = std::min(height, static_cast<int>(high.y()) + margin + 1);
    if (x0 >= x1 || y0 >= y1) continue;
    const int columns = (x1 - x0) * kSub, rows = (y1 - y0) * kSub;
    std::vector<float> fine(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows));
    // A pixel that shows the bare platter, as all around it do, needs no search for what hides a part of it.
    const int wide = x1 - x0 + 2;
    std::vector<Vector3d> rays_T;  // of these pixels and of one beyond on each side
    std::vector<std::uint8_t> bare;
    for (int y = y0 - 1; y <= y1; ++y) {
      for (int x = x0 - 1; x <= x1; ++x) {
        rays_T.push_back(pose.direction_to_table(camera.ray_W(x, y)));
        const auto hit = scene.intersect({centre_T, rays_T.back()});
        bare.push_back(hit && hit->material == Material::platter);
      }
    }
    const auto all_bare = [&](int x, int y) {
      for (int row = y - y0; row <= y - y0 + 2; ++row) {
        const auto from = bare.begin() + row * wide + x - x0;
        if (std::find(from, from + 3, 0) != from + 3) return false;
      }
      return true;
    };
    const auto print_at = [&](const Vector3d& d_T, bool on_platter) -> std::optional<Hit> {
      if (!on_platter) return scene.intersect({centre_T, d_T});
      const double t = -centre_T.z() / d_T.z();
      const Vector3d p = centre_T + t * d_T;
      return Hit{t, p, Vector3d(0, 0, centre_T.z() >= 0 ? 1 : -1), Material::platter,
                 0, 0, scene.print_on_platter(p.x(), p.y())};
    };
    for (int y = y0; y < y1; ++y) {
      for (int x = x0; x < x1; ++x) {
        // Rays change linearly over a pixel.
        const Vector3d* const ray = &rays_T[static_cast<std::size_t>((y - y0 + 1) * wide + x - x0 + 1)];
        const Vector3d d = ray[0], right = ray[1] - d, down = ray[wide] - d;
        const bool on_platter = all_bare(x, y);
        const float plain =
            levels_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)];
        for (int j = 0; j < kSub; ++j) {
          for (int i = 0; i < kSub; ++i) {
            const double u = (i - 0.5 * (kSub - 1) + strewn(y * kSub + j)) / kSub,
                         v = (j - 0.5 * (kSub - 1) + strewn(x * kSub + i)) / kSub;
            const auto hit = print_at(d + u * right + v * down, on_platter);
            fine[static_cast<std::size_t>((y - y0) * kSub + j) * static_cast<std::size_t>(columns) +
                 static_cast<std::size_t>((x - x0) * kSub + i)] =
                hit && hit->print > 0 ? static_cast<float>(brightness(*hit, lamp_T)) : plain;
          }
        }
      }
    }
    for (int j = 0; j < rows; ++j)
      blur(&fine[static_cast<std::size_t>(j) * static_cast<std::size_t>(columns)], columns, 1, taps, copy);
    for (int i = 0; i < columns; ++i) blur(&fine[static_cast<std::size_t>(i)], rows, columns, taps, copy);
    for (int y = y0; y < y1; ++y) {
      for (int x = x0; x < x1; ++x) {
        levels_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)] =
            fine[static_cast<std::size_t>((y - y0) * kSub + kSub / 2) * static_cast<std::size_t>(columns) +
                 static_cast<std::size_t>((x - x0) * kSub + kSub / 2)];
      }
    }
  }
}

}  // namespace celadon::sim
