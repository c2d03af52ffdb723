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

/// 0 to 1 over the width of an edge. @param in_mm  from the edge inwards
double merged(double in_mm) {
  const double t = std::clamp(in_mm / Paint::kEdge_mm + 0.5, 0., 1.);
  return t * t * (3 - 2 * t);
}

}  // namespace

const std::array<Eigen::Array3d, 3> Paint::kSectors{Eigen::Array3d(0.9, 0.3, 0.25), Eigen::Array3d(0.5, 0.85, 0.35),
                                                    Eigen::Array3d(0.45, 0.5, 0.95)};

tl::expected<Paint, std::string> Paint::parse(const std::string& text) {
  if (text == "none") return Paint();
  if (text == "sectors") return Paint{Where::sectors, 1};
  constexpr std::string_view kThird = "third:", kBands = "bands:";
  const bool third = text.starts_with(kThird);
  if (third || text.starts_with(kBands)) {
    const char* const number = text.c_str() + kThird.size();
    char* end = nullptr;
    const double albedo = std::strtod(number, &end);
    if (end != number && *end == '\0' && albedo >= kLeastAlbedo && albedo <= 1)
      return Paint{third ? Where::third : Where::bands, albedo};
  }
  return tl::unexpected(
      "the paint \"" + text +
      "\" is unknown; give none, sectors, third:ALBEDO or bands:ALBEDO with an albedo from 0.001 to 1");
}

double Paint::albedo_at(const Eigen::Vector3d& p) const {
  if (where == Where::nowhere) return 1;
  if (coloured()) return reflectance_at(p).x();
  const double t = std::clamp(depth_mm(where, p) / kEdge_mm + 0.5, 0., 1.);
  return 1 + (albedo - 1) * t * t * (3 - 2 * t);
}

Eigen::Array3d Paint::reflectance_at(const Eigen::Vector3d& p) {
  const double psi = std::atan2(p.y(), p.x());
  const double sectors = (psi < 0 ? psi + 2 * std::numbers::pi : psi) / kThird_rad;
  const auto here = static_cast<std::size_t>(sectors) % 3;
  const double into = sectors - std::floor(sectors), edge = std::min(into, 1 - into);
  const std::size_t beside = (here + (into < 0.5 ? 2 : 1)) % 3;
  const double share = merged(edge * kThird_rad * std::hypot(p.x(), p.y()));
  return kSectors[beside] + share * (kSectors[here] - kSectors[beside]);
}

std::string to_string(const Paint& paint) {
  if (paint.where == Paint::Where::nowhere) return "none";
  if (paint.coloured()) return "sectors";
  char text[40];
  std::snprintf(text, sizeof text, "%s:%g", paint.where == Paint::Where::third ? "third" : "bands", paint.albedo);
  return text;
}

}  // namespace celadon::sim
