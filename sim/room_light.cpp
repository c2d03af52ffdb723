#include "sim/room_light.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/rotation.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr double kCell_rad = 5 * std::numbers::pi / 180;
constexpr double kHeadCell_rad = std::numbers::pi / 180, kLiftCell_mm = 1;
constexpr double kPaintedCell_rad = 1e-6, kPaintedCell_mm = 1e-4;
constexpr int kBlock = 8;  // room light is rendered on every eighth pixel

// The lamp hangs in the room: it stays when the head turns.
Vector3d lamp_in_table(const Posture& posture) {
  return turned(Vector3d(0.35, 0.55, 0.75).normalized(), std::cos(posture.table_rad), -std::sin(posture.table_rad));
}

}  // namespace

RoomLight::RoomLight(const OpticsConfig& config)
    : config_(config),
      shaded_(static_cast<std::size_t>(config.camera.width_px) * static_cast<std::size_t>(config.camera.height_px)),
      levels_(shaded_.size()),
      textures_(config),
      prints_(config) {}

void RoomLight::update(const Scene& scene, const VirtualCamera& camera, const Exposure& exposure) {
  const int height = config_.camera.height_px;
  const Posture posture = exposure.posture_at(0.5 * height, 0);
  coloured_ = scene.coloured();
  const bool plain = scene.printed().empty() && !scene.textured() && !coloured_;
  const auto stepped = [](double value, double step) { return std::round(value / step) * step; };
  Posture exact, near;  // near: for what may be shown a little turned
  exact.elevation_rad = near.elevation_rad = stepped(posture.elevation_rad, plain ? kHeadCell_rad : kPaintedCell_rad);
  if (!scene.held()) exact.lift_mm = near.lift_mm = stepped(posture.lift_mm, plain ? kLiftCell_mm : kPaintedCell_mm);
  if (!scene.turns_invisibly()) {
    exact.table_rad = stepped(posture.table_rad, kPaintedCell_rad);
    near.table_rad = scene.object_is_printed() ? exact.table_rad : stepped(posture.table_rad, kCell_rad);
  }
  const bool shaded = ready_ && near == shaded_at_;
  if (!shaded) shade(scene, camera, near);
  const bool rows_differ =
      !scene.printed().empty() && apart_rad(exposure.posture_at(0, 0), exposure.posture_at(height - 1.0, 0),
                                            !scene.turns_invisibly()) > kPaintedCell_rad;
  if (shaded && (plain || (exact == painted_at_ && !rows_differ))) return;
  levels_ = shaded_;
  const Vector3d lamp_T = lamp_in_table(exact);
  const TablePose middle = scene.table_pose(exact, {}, config_.axes);
  const auto lit = [&](const Hit& hit) { return brightness(hit, lamp_T); };
  if (coloured_) {
    paint_colours(scene, camera, middle, lamp_T);
  } else if (scene.textured()) {
    const auto look = [&](const Hit& hit) {
      return std::array<float, 3>{static_cast<float>(lit(hit) * scene.albedo(hit))};
    };
    textures_.paint(scene, camera, middle, look, std::span(&levels_, 1));
  }
  const auto pose_of = [&](int row) {
    return rows_differ ? scene.table_pose(exposure.posture_at(row, 0), {}, config_.axes) : middle;
  };
  prints_.paint(scene, camera, pose_of, lit, levels_);
  if (coloured_) {
    for (std::vector<float>& plane : colours_) prints_.paint(scene, camera, pose_of, lit, plane);
  }
  ready_ = true;
  shaded_at_ = near;
  painted_at_ = rows_differ ? std::nullopt : std::optional(exact);
}

void RoomLight::paint_colours(const Scene& scene, const VirtualCamera& camera, const TablePose& pose,
                              const Vector3d& lamp_T) {
  static constexpr std::array<float, 3> kGrey{0.299F, 0.587F, 0.114F};  // what a grey camera makes of white light
  colours_.fill(shaded_);
  const auto look = [&](const Hit& hit) {
    const Eigen::Array3f level = (brightness(hit, lamp_T) * scene.reflectance(hit)).cast<float>();
    return std::array<float, 3>{level.x(), level.y(), level.z()};
  };
  textures_.paint(scene, camera, pose, look, colours_);
  for (std::size_t i = 0; i < levels_.size(); ++i)
    levels_[i] = kGrey[0] * colours_[0][i] + kGrey[1] * colours_[1][i] + kGrey[2] * colours_[2][i];
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
        if (hit->material == Material::object && !scene.object_is_printed()) level *= scene.painted(*hit);
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

}  // namespace celadon::sim
