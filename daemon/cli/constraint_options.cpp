#include "daemon/cli/constraint_options.h"

#include <charconv>
#include <cmath>

namespace celadon::cli {
namespace {

constexpr double kDegree_rad = std::numbers::pi / 180;
constexpr int kMostFold = 90;

std::optional<double> number(std::string_view text) {
  double value = 0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
  if (parsed.ec != std::errc{} || parsed.ptr != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

}  // namespace

void add_constraint_options(CLI::App& command, ConstraintArguments& arguments) {
  command
      .add_option("--fix-radius", arguments.radii,
                  "hold this radius all around at this height of the surface's own frame exactly, as HEIGHT=RADIUS "
                  "[mm]; several may be given")
      ->type_name("HEIGHT=RADIUS");
  command
      .add_option("--fix-angle-below", arguments.angle_below_deg,
                  "hold this angle between wall and axis at the lower rim [degrees]; positive: wider upwards")
      ->check(CLI::Range(-89.0, 89.0));
  command.add_option("--fix-angle-above", arguments.angle_above_deg, "the same at the upper rim [degrees]")
      ->check(CLI::Range(-89.0, 89.0));
  command
      .add_option("--symmetry", arguments.fold,
                  "the part turned by 360/N degrees is itself: all of it is fitted as N times the same")
      ->check(CLI::Range(1, kMostFold));
  command
      .add_option("--mirror", arguments.mirror,
                  "the part is its own mirror image in a half plane at this angle [degrees]; auto: where it is most so")
      ->check(CLI::Validator(
          [](std::string& text) -> std::string {
            return text == "none" || text == "auto" || number(text) ? "" : "'" + text + "' must be an angle or auto";
          },
          "ANGLE|auto"));
}

tl::expected<Constraints, std::string> constraints_of(const ConstraintArguments& arguments) {
  Constraints constraints;
  for (const std::string& text : arguments.radii) {
    const std::size_t equals = std::min(text.find('='), text.size());
    const auto height = number(std::string_view(text).substr(0, equals));
    const auto radius = number(std::string_view(text).substr(std::min(equals + 1, text.size())));
    if (!height || !radius)
      return tl::make_unexpected("--fix-radius: '" + text + "' is not HEIGHT=RADIUS in mm, such as 12.5=30");
    constraints.radii.push_back({*height, *radius});
  }
  if (arguments.angle_below_deg) constraints.angle_start_rad = *arguments.angle_below_deg * kDegree_rad;
  if (arguments.angle_above_deg) constraints.angle_end_rad = *arguments.angle_above_deg * kDegree_rad;
  return constraints;
}

SymmetryRequest symmetry_of(const ConstraintArguments& arguments) {
  SymmetryRequest request{.fold = arguments.fold, .mirrored = arguments.mirror != "none"};
  if (const auto angle = number(arguments.mirror)) request.plane_rad = *angle * kDegree_rad;
  return request;
}

}  // namespace celadon::cli
