#include "sim/artefact.h"

#include <charconv>
#include <cmath>
#include <numbers>

#include "sim/assembly_body.h"
#include "sim/box_body.h"
#include "sim/turned_body.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr double kPlateRadius_mm = 60, kPlate_mm = 8, kStemRadius_mm = 4;
constexpr double kFlatAzimuth_rad = 305 * std::numbers::pi / 180;
constexpr double kFlatBeside_mm = 46, kBlockDepth_mm = 12, kFlatWidth_mm = 28, kFlatHeight_mm = 34;

/// Shortest decimals that read back as the same double, with the point that TOML wants.
std::string decimals(double value) {
  char buffer[32];
  std::string text(buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr);
  if (text.find_first_of(".e") == std::string::npos) text += ".0";
  return text;
}

std::string vector_text(const Vector3d& v) {
  return "[" + decimals(v.x()) + ", " + decimals(v.y()) + ", " + decimals(v.z()) + "]";
}

}  // namespace

const std::vector<ArtefactBall>& artefact_balls() {
  static const std::vector<ArtefactBall> balls{
      {"A", 30.0124, {40, 0, 28}}, {"B", 30.0071, {-22, 31, 78}}, {"C", 24.0048, {-8, -18, 52}}};
  return balls;
}

const ArtefactFlat& artefact_flat() {
  static const Vector3d out(std::cos(kFlatAzimuth_rad), std::sin(kFlatAzimuth_rad), 0);
  static const ArtefactFlat flat{kFlatBeside_mm * out + Vector3d(0, 0, kPlate_mm + kFlatHeight_mm / 2), out,
                                 kFlatWidth_mm, kFlatHeight_mm};
  return flat;
}

std::shared_ptr<const Body> make_artefact() {
  const auto cylinder = [](double radius_mm, double height_mm) {
    return std::make_shared<TurnedBody>(std::vector<TurnedPoint>{{0, radius_mm}, {height_mm, radius_mm}});
  };
  std::vector<AssembledPart> parts{{cylinder(kPlateRadius_mm, kPlate_mm)}};
  for (const ArtefactBall& ball : artefact_balls()) {
    const Vector3d& c = ball.centre_mm;
    parts.push_back({std::make_shared<SphereBody>(ball.diameter_mm / 2), c - Vector3d(0, 0, ball.diameter_mm / 2)});
    parts.push_back({cylinder(kStemRadius_mm, c.z() - kPlate_mm), {c.x(), c.y(), kPlate_mm}});
  }
  const ArtefactFlat& flat = artefact_flat();
  const Vector3d middle = flat.centre_mm - kBlockDepth_mm / 2 * flat.normal;
  parts.push_back({std::make_shared<BoxBody>(kBlockDepth_mm, flat.width_mm, flat.height_mm),
                   {middle.x(), middle.y(), kPlate_mm},
                   kFlatAzimuth_rad});
  return std::make_shared<AssemblyBody>(parts);
}

std::string artefact_certificate() {
  std::string text =
      "format = \"celadon-artefact\"\nversion = \"1.0\"\nname = \"ball plate of the virtual scanner\"\n"
      "certificate = \"closed form, exact\"\n";
  const auto& balls = artefact_balls();
  for (const ArtefactBall& ball : balls) {
    text += "\n[[sphere]]\nname = \"" + ball.name + "\"\ncentre_mm = " + vector_text(ball.centre_mm) +
            "\ndiameter = { value = " + decimals(ball.diameter_mm) + ", u = 0.0 }\n";
  }
  for (std::size_t i = 0; i < balls.size(); ++i) {
    for (std::size_t j = i + 1; j < balls.size(); ++j) {
      const double apart_mm = (balls[i].centre_mm - balls[j].centre_mm).norm();
      text += "\n[[spacing]]\nbetween = [\"" + balls[i].name + "\", \"" + balls[j].name +
              "\"]\ndistance = { value = " + decimals(apart_mm) + ", u = 0.0 }\n";
    }
  }
  const ArtefactFlat& flat = artefact_flat();
  text += "\n[flat]\ncentre_mm = " + vector_text(flat.centre_mm) + "\nnormal = " + vector_text(flat.normal) +
          "\nwidth_mm = " + decimals(flat.width_mm) + "\nheight_mm = " + decimals(flat.height_mm) + "\n";
  return text;
}

}  // namespace celadon::sim
