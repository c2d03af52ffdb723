#include <cmath>
#include <numbers>

#include "sim/scene.h"

namespace celadon::sim {
namespace {

constexpr double kRadius_mm = 66, kTag_mm = 11.2;
constexpr int kFirst = 100;

}  // namespace

RimTags::RimTags(int count) {
  for (int i = 0; i < count; ++i) {
    const double a = 2 * std::numbers::pi * i / count;
    tags_.push_back({Target::tag(kFirst + i, kTag_mm), std::cos(a), std::sin(a)});
  }
}

// The tag's x runs counter-clockwise, its y outwards.
Eigen::Vector3d RimTags::on_platter(std::size_t tag, double x, double y) const {
  const double c = tags_[tag].cos, s = tags_[tag].sin, out = kRadius_mm + y;
  return {c * out - s * x, s * out + c * x, 0};
}

std::size_t RimTags::nearest(double x, double y) const {
  if (tags_.empty()) return 0;
  const auto count = static_cast<int>(tags_.size());
  const int at = static_cast<int>(std::round(std::atan2(y, x) / (2 * std::numbers::pi) * count));
  return static_cast<std::size_t>((at % count + count) % count);
}

double RimTags::reflectance(std::size_t tag, double x, double y) const {
  if (tags_.empty()) return 0;
  const auto& [target, c, s] = tags_[tag];
  return target.reflectance(c * y - s * x, c * x + s * y - kRadius_mm);
}

double RimTags::reflectance(double x, double y) const {
  // Most of what is seen of the platter lies further inside.
  constexpr double kInside = kRadius_mm - kTag_mm;
  if (x * x + y * y < kInside * kInside) return 0;
  return reflectance(nearest(x, y), x, y);
}

std::vector<PrintedCorner> RimTags::corners() const {
  std::vector<PrintedCorner> out;
  for (std::size_t i = 0; i < tags_.size(); ++i) {
    for (const TargetCorner& corner : tags_[i].target.corners()) {
      out.push_back({corner.id, corner.corner, on_platter(i, corner.p_mm.x(), corner.p_mm.y())});
    }
  }
  return out;
}

std::vector<std::vector<Eigen::Vector3d>> RimTags::outlines() const {
  std::vector<std::vector<Eigen::Vector3d>> out;
  for (std::size_t i = 0; i < tags_.size(); ++i) {
    const double x = 0.5 * tags_[i].target.width_mm();
    out.push_back({on_platter(i, -x, -x), on_platter(i, x, -x), on_platter(i, x, x), on_platter(i, -x, x)});
  }
  return out;
}

}  // namespace celadon::sim
