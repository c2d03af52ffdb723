#include "sim/paint.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numbers>
#include <string_view>

namespace celadon::sim {
namespace {

constexpr double kThird_rad = 2 * std::numbers::pi / 3;
constexpr double kLeastAlbedo = 1e-3;

/// From the paint's edge inwards, mm; negative outside.
double depth_mm(Paint::Where where, const Eigen::Vector3d& p) {
  if (where == Paint::Where::bands) {
    constexpr double kPeriod = 2 * Paint::kBand_mm;
    const double along = p.z() - kPeriod * std::floor(p.z() / kPeriod);
    return 0.5 * Paint::kBand_mm - std::abs(along - 1.5 * Paint::kBand_mm);
  }
  const double off = std::remainder(std::atan2(p.y(), p.x()) - 0.5 * kThird_rad, 2 * std::numbers::pi);
  return (0.5 * kThird_rad - std::abs(off)) * std::hypot(p.x(), p.y());
}

}  // namespace

tl::expected<Paint, std::string> Paint::parse(const std::string& text) {
  if (text == "none") return Paint();
  constexpr std::string_view kThird = "third:", kBands = "bands:";
  const bool third = text.starts_with(kThird);
  if (third || text.starts_with(kBands)) {
    const char* const number = text.c_str() + kThird.size();
    char* end = nullptr;
    const double albedo = std::strtod(number, &end);
    if (end != number && *end == '\0' && albedo >= kLeastAlbedo && albedo <= 1)
      return Paint{third ? Where::third : Where::bands, albedo};
  }
  return tl::unexpected("the paint \"" + text +
                        "\" is unknown; give none, third:ALBEDO or bands:ALBEDO with an albedo from 0.001 to 1");
}

double Paint::albedo_at(const Eigen::Vector3d& p) const {
  if (where == Where::nowhere) return 1;
  const double t = std::clamp(depth_mm(where, p) / kEdge_mm + 0.5, 0., 1.);
  return 1 + (albedo - 1) * t * t * (3 - 2 * t);
}

std::string to_string(const Paint& paint) {
  if (paint.where == Paint::Where::nowhere) return "none";
  char text[40];
  std::snprintf(text, sizeof text, "%s:%g", paint.where == Paint::Where::third ? "third" : "bands", paint.albedo);
  return text;
}

}  // namespace celadon::sim
