// celadon evaluate: points, normals and curvatures of a surface file as CSV.

#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "daemon/cli/commands.h"
#include "daemon/files/atomic_file.h"
#include "daemon/surface_json.h"

namespace celadon::cli {
namespace {

constexpr std::size_t kMostValues = 10'000'000;

struct EvaluateArguments {
  std::string surface, angles = "0:10:350", heights, polar, output;
  std::size_t piece = 1;
};

// "a,b,c" or "first:step:last"; nullopt when it is neither.
std::optional<std::vector<double>> numbers_from(const std::string& text) {
  const auto split = [&](char separator) {
    std::vector<double> values;
    for (std::size_t at = 0; at <= text.size();) {
      const std::size_t next = std::min(text.find(separator, at), text.size());
      std::size_t used = 0;
      double value = 0;
      try {
        value = std::stod(text.substr(at, next - at), &used);
      } catch (const std::exception&) {
        return std::vector<double>{};
      }
      if (used != next - at || !std::isfinite(value)) return std::vector<double>{};
      values.push_back(value);
      at = next + 1;
    }
    return values;
  };
  if (text.find(':') == std::string::npos) {
    auto list = split(',');
    return list.empty() ? std::nullopt : std::optional(list);
  }
  const auto range = split(':');
  if (range.size() != 3 || range[1] == 0 || (range[2] - range[0]) / range[1] < 0) return std::nullopt;
  const double steps = std::floor((range[2] - range[0]) / range[1] + 1e-9);
  if (steps >= static_cast<double>(kMostValues)) return std::nullopt;
  std::vector<double> values(static_cast<std::size_t>(steps) + 1);
  for (std::size_t k = 0; k < values.size(); ++k) values[k] = range[0] + static_cast<double>(k) * range[1];
  return values;
}

int evaluate(const EvaluateArguments& arguments) {
  const auto file = read_surface_json(arguments.surface);
  if (!file) return fail(2, file.error());
  const auto angles_deg = numbers_from(arguments.angles);
  if (!angles_deg)
    return fail(2, "--angles '" + arguments.angles + "' is neither a list a,b,c nor a range first:step:last");
  if (arguments.piece < 1 || arguments.piece > file->pieces.size()) {
    return fail(2, "'" + arguments.surface + "' has no piece " + std::to_string(arguments.piece) + "; it has " +
                       std::to_string(file->pieces.size()) + ", counted from below");
  }
  const SurfacePiece& piece = file->pieces[arguments.piece - 1];
  const RangeFunction& function = piece.function;
  const BaseSurface& base = function.base();
  // Along the base: heights in mm, on a sphere polar angles in degrees.
  const bool spherical = base.spherical();
  const std::string& asked = spherical ? arguments.polar : arguments.heights;
  const char* const option = spherical ? "--polar" : "--heights";
  if (!(spherical ? arguments.heights : arguments.polar).empty()) {
    return fail(2, std::string("piece ") + std::to_string(arguments.piece) + " of '" + arguments.surface +
                       "' is over a " + (spherical ? "sphere" : "cylinder") + "; ask for points with " + option);
  }
  constexpr double kDegrees = 180 / std::numbers::pi;
  const auto shown = [&](double along) {
    return spherical ? BaseSurface::meridian().theta_of_v(along) * kDegrees : along;
  };
  const double start = shown(base.band_start), end = shown(base.band_end);
  std::vector<double> places;
  if (asked.empty()) {
    for (int k = 0; k <= 20; ++k) places.push_back(start + k * (end - start) / 20);
  } else if (const auto given = numbers_from(asked)) {
    places = *given;
  } else {
    return fail(2, std::string(option) + " '" + asked + "' is neither a list a,b,c nor a range first:step:last");
  }
  for (const double angle : *angles_deg) {
    if (!base.arcs.contains(angle / kDegrees)) {
      char text[256];
      const double from = base.arcs.start_rad() * kDegrees;
      std::snprintf(text, sizeof text,
                    "angle %g degrees is outside the surface's part of the turn, %.6f .. %.6f; it is "
                    "never extrapolated",
                    angle, from, from + base.arcs.count() * base.arcs.arc_rad() * kDegrees);
      return fail(2, text);
    }
  }
  if (angles_deg->size() * places.size() > kMostValues) {
    return fail(2, std::to_string(angles_deg->size() * places.size()) + " points are more than " +
                       std::to_string(kMostValues) + "; ask for fewer");
  }
  for (const double place : places) {
    if (!base.heights && (place < start || place > end)) {
      char text[256];
      std::snprintf(text, sizeof text,
                    spherical
                        ? "polar angle %g degrees is outside the surface's band %.6f .. %.6f degrees; it is never "
                          "extrapolated"
                        : "height %g mm is outside the surface's band %.6f .. %.6f mm; it is never extrapolated",
                    place, start, end);
      return fail(2, text);
    }
  }
  std::string csv = spherical ? "angle_deg,polar_deg,rho_mm" : "angle_deg,height_mm,r_mm";
  csv += ",x_mm,y_mm,z_mm,normal_x,normal_y,normal_z,curvature_max_per_mm,curvature_min_per_mm";
  csv += piece.deviation ? ",sd_mm\n" : "\n";
  for (const double place : places) {
    for (const double angle : *angles_deg) {
      const double theta = angle * std::numbers::pi / 180;
      // Heights that were not asked for run from rim to rim.
      const double z = spherical ? (place == end ? base.band_end : BaseSurface::meridian().v_of_theta(place / kDegrees))
                       : asked.empty() ? place
                                       : base.along_at(theta, place);
      const double shown_place = base.heights && asked.empty() ? base.z_mm(theta, z) : place;
      if (base.heights && !asked.empty() && (z < base.band_start || z > base.band_end)) {
        char text[256];
        std::snprintf(text, sizeof text,
                      "height %g mm is outside the surface's band %.6f .. %.6f mm at %g degrees; it is never "
                      "extrapolated",
                      place, base.z_mm(theta, base.band_start), base.z_mm(theta, base.band_end), angle);
        return fail(2, text);
      }
      const SurfacePoint point = function.surface_point(theta, z);
      char row[512];
      std::snprintf(row, sizeof row, "%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g", angle,
                    shown_place, function(theta, z), point.p_W.x(), point.p_W.y(), point.p_W.z(), point.normal_W.x(),
                    point.normal_W.y(), point.normal_W.z(), point.curvature_max, point.curvature_min);
      csv += row;
      if (piece.deviation) {
        std::snprintf(row, sizeof row, ",%.4g", (*piece.deviation)(base.arcs.v_of_theta(theta), z));
        csv += row;
      }
      csv += '\n';
    }
  }
  if (arguments.output.empty()) {
    return std::fwrite(csv.data(), 1, csv.size(), stdout) == csv.size() && std::fflush(stdout) == 0
               ? 0
               : fail(4, "standard output cannot be written");
  }
  const auto written = write_file_atomically(arguments.output, csv);
  return written ? 0 : fail(4, written.error().message);
}

}  // namespace

void add_evaluate_command(CLI::App& program, Run& run) {
  auto arguments = std::make_shared<EvaluateArguments>();
  auto* command = program.add_subcommand("evaluate",
                                         "Points, outward normals and principal curvatures (1/mm, positive where "
                                         "convex) of a surface.json as CSV, and the\n"
                                         "standard deviation of the range along the ray where the file holds it.");
  command->option_defaults()->always_capture_default();
  command->add_option("SURFACE", arguments->surface, "surface.json of a scan or fit")->required();
  command->add_option("--angles", arguments->angles, "angles [degrees]: a list a,b,c or a range first:step:last");
  command->add_option("--heights", arguments->heights,
                      "heights in the surface's frame [mm], list or range; default: 21 over its band");
  command->add_option("--polar", arguments->polar,
                      "polar angles of a surface over a sphere [degrees], list or range; default: 21 over its band");
  command->add_option("--piece", arguments->piece, "which piece of a composite, counted from below");
  command->add_option("-o,--output", arguments->output, "CSV file; default: standard output");
  command->callback([arguments, &run] { run = [arguments] { return evaluate(*arguments); }; });
}

}  // namespace celadon::cli
