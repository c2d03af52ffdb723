#include "sim/print_painter.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr int kCell = 4;  // pixels: what is thinner may hide a part of a tag on the platter and is not seen to

// In [-0.5, 0.5), evenly spread over any run of numbers: an edge along a row or a column of samples is met in all
// phases.
double strewn(int number) {
  const double at = number * 0.6180339887498949;
  return at - std::floor(at) - 0.5;
}

enum class Seen : std::uint8_t { platter, object, nothing };

/// Rays at the corners of cells, from one cell beyond the patch on each side, and what they show.
class Corners {
 public:
  Corners(int x0, int y0, int x1, int y1, const std::function<Vector3d(int, int)>& ray_T,
          const std::function<Seen(int, const Vector3d&)>& seen_along)
      : x0_(x0 - kCell), y0_(y0 - kCell), columns_((x1 - x0 + kCell - 1) / kCell + 3) {
    const int rows = (y1 - y0 + kCell - 1) / kCell + 3;
    for (int j = 0; j < rows; ++j) {
      for (int i = 0; i < columns_; ++i) {
        rays_T_.push_back(ray_T(x0_ + i * kCell, y0_ + j * kCell));
        seen_.push_back(seen_along(y0_ + j * kCell, rays_T_.back()));
      }
    }
  }
  /// This is all that is seen of the pixel's cell and about it.
  bool all(Seen seen, int x, int y) const {
    const int i = (x - x0_) / kCell, j = (y - y0_) / kCell;
    for (int row = j - 1; row <= j + 2; ++row) {
      const auto from = seen_.begin() + row * columns_ + i - 1;
      if (std::any_of(from, from + 4, [&](Seen there) { return there != seen; })) return false;
    }
    return true;
  }
  /// Between the corners of its cell: rays bend by less than a thousandth of a pixel there.
  Vector3d ray_T(double x, double y) const {
    const int i = static_cast<int>((x - x0_) / kCell), j = static_cast<int>((y - y0_) / kCell);
    const double u = (x - x0_) / kCell - i, v = (y - y0_) / kCell - j;
    const Vector3d* const above = &rays_T_[static_cast<std::size_t>(j * columns_ + i)];
    const Vector3d* const below = above + columns_;
    return (1 - v) * ((1 - u) * above[0] + u * above[1]) + v * ((1 - u) * below[0] + u * below[1]);
  }

 private:
  int x0_, y0_, columns_;
  std::vector<Vector3d> rays_T_;
  std::vector<Seen> seen_;
};

}  // namespace

PrintPainter::PrintPainter(const OpticsConfig& config)
    : width_(config.camera.width_px), height_(config.camera.height_px), blur_(config.blur_px, kSub) {}

Patch PrintPainter::patch_of(const std::vector<Vector3d>& outline, const VirtualCamera& camera,
                             const std::function<TablePose(int)>& pose_of_row) const {
  Eigen::Vector2d low(width_, height_), high(0, 0);
  for (const int row : {0, height_ - 1}) {
    const TablePose pose = pose_of_row(row);
    for (const Vector3d& p : outline) {
      const Eigen::Vector2d pixel = camera.project(pose.to_head(p));
      low = low.cwiseMin(pixel);
      high = high.cwiseMax(pixel);
    }
  }
  const int margin = blur_.margin_px();
  return {std::max(0, static_cast<int>(low.x()) - margin), std::max(0, static_cast<int>(low.y()) - margin),
          std::min(width_, static_cast<int>(high.x()) + margin + 1),
          std::min(height_, static_cast<int>(high.y()) + margin + 1)};
}

void PrintPainter::paint(const Scene& scene, const VirtualCamera& camera,
                         const std::function<TablePose(int)>& pose_of_row,
                         const std::function<double(const Hit&)>& brightness, std::vector<float>& levels) {
  const auto centre_T_of = [&](int row) { return pose_of_row(row).to_table(camera.centre_W()); };
  const auto exact_ray_T = [&](int x, int y) { return pose_of_row(y).direction_to_table(camera.ray_W(x, y)); };
  const auto seen_along = [&](int row, const Vector3d& ray_T) {
    const auto hit = scene.intersect({centre_T_of(row), ray_T});
    return !hit ? Seen::nothing : hit->material == Material::platter ? Seen::platter : Seen::object;
  };
  const bool object_hides = !scene.object_is_printed();
  const RimTags& tags = scene.rim_tags();
  const Vector3d up(0, 0, centre_T_of(height_ / 2).z() >= 0 ? 1 : -1);
  for (const auto& outline : scene.printed()) {
    const Patch patch = patch_of(outline, camera, pose_of_row);
    if (patch.empty()) continue;
    const Corners corners(patch.x0, patch.y0, patch.x1, patch.y1, exact_ray_T, seen_along);
    const std::size_t tag = tags.nearest(outline.front().x(), outline.front().y());
    const int columns = patch.width() * kSub;
    fine_.resize(static_cast<std::size_t>(columns) * static_cast<std::size_t>((patch.y1 - patch.y0) * kSub));
    for (int y = patch.y0; y < patch.y1; ++y) {
      const TablePose pose = pose_of_row(y);
      const Vector3d centre_T = pose.to_table(camera.centre_W());
      const auto ray_T_of_row = [&](int x, int row) { return pose.direction_to_table(camera.ray_W(x, row)); };
      for (int x = patch.x0; x < patch.x1; ++x) {
        const float plain = levels[static_cast<std::size_t>(y * width_ + x)];
        float* const out = &fine_[static_cast<std::size_t>((y - patch.y0) * kSub * columns + (x - patch.x0) * kSub)];
        if (object_hides && corners.all(Seen::object, x, y)) {
          for (int j = 0; j < kSub; ++j) std::fill_n(out + j * columns, kSub, plain);
          continue;
        }
        const bool on_platter = corners.all(Seen::platter, x, y);
        const Vector3d d = on_platter ? corners.ray_T(x, y) : ray_T_of_row(x, y),
                       right = (on_platter ? corners.ray_T(x + 1, y) : ray_T_of_row(x + 1, y)) - d,
                       down = (on_platter ? corners.ray_T(x, y + 1) : ray_T_of_row(x, y + 1)) - d;
        const auto hit_along = [&](const Vector3d& ray_T) -> std::optional<Hit> {
          if (!on_platter) return scene.intersect({centre_T, ray_T});
          const double t = -centre_T.z() / ray_T.z();
          const Vector3d p = centre_T + t * ray_T;
          return Hit{t, p, up, Material::platter, 0, 0, tags.reflectance(tag, p.x(), p.y())};
        };
        for (int j = 0; j < kSub; ++j) {
          for (int i = 0; i < kSub; ++i) {
            const double u = (i - 0.5 * (kSub - 1) + strewn(y * kSub + j)) / kSub,
                         v = (j - 0.5 * (kSub - 1) + strewn(x * kSub + i)) / kSub;
            const auto hit = hit_along(d + u * right + v * down);
            out[j * columns + i] = hit && hit->print > 0 ? static_cast<float>(brightness(*hit)) : plain;
          }
        }
      }
    }
    blur_.apply(fine_, patch, width_, levels);
  }
}

}  // namespace celadon::sim
