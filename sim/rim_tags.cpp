#include <cmath>
#include <numbers>

#include "sim/scene.h"

namespace celadon::sim {
namespace {

constexpr double kRadius_mm = 66, kTag_mm = 11.2;
constexpr int kFirst = 100;

}  // namespace

RimTags::RimTags(int count) {
  for (int i = 0; i < count; ++i) tags_.push_back(Target::tag(kFirst + i, kTag_mm));
}

// The tag's x runs counter-clockwise, its y outwards.
Eigen::Vector3d RimTags::on_platter(std::size_t tag, double x, double y) const {
  const double a = 2 * std::numbers::pi * static_cast<double>(tag) / static_cast<double>(tags_.size());
  const double c = std::cos(a), s = std::sin(a), out = kRadius_mm + y;
  return {c * out - s * x, s * out + c * x, 0};
}

double RimTags::reflectance(double x, double y) const {
  if (tags_.empty()) return 0;
  const double step = 2 * std::numbers::pi / static_cast<double>(tags_.size());
  const double at = std::round(std::atan2(y, x) / step), a = at * step, c = std::cos(a), s = std::sin(a);
  const auto count = static_cast<int>(tags_.size());
  const int tag = (static_cast<int>(at) % count + count) % count;
  return tags_[static_cast<std::size_t>(tag)].reflectance(c * y - s * x, c * x + s * y - kRadius_mm);
}

std::vector<PrintedCorner> RimTags::corners() const {
  std::vector<PrintedCorner> out;
  for (std::size_t i = 0; i < tags_.size(); ++i) {
    for (const TargetCorner& corner : tags_[i].corners()) {
      out.push_back({corner.id, corner.corner, on_platter(i, corner.p_mm.x(), corner.p_mm.y())});
    }
  }
  return out;
}

std::vector<std::vector<Eigen::Vector3d>> RimTags::outlines() const {
  std::vector<std::vector<Eigen::Vector3d>> out;
  for (std::size_t i = 0; i < tags_.size(); ++i) {
    const double x = 0.5 * tags_[i].width_mm();
    out.push_back({on_platter(i, -x, -x), on_platter(i, x, -x), on_platter(i, x, x), on_platter(i, -x, x)});
  }
  return out;
}

}  // namespace celadon::sim
