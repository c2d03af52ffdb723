#include "daemon/cli/summary.h"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <numbers>

#include "daemon/checks/self_check.h"

namespace celadon::cli {
namespace {

using nlohmann::json;

template <class... Values>
std::string line(const char* format, Values... values) {
  char text[512];
  std::snprintf(text, sizeof text, format, values...);
  return std::string(text) + "\n";
}

// Four significant digits, in micrometres where that reads better.
std::string length(double mm) {
  char text[64];
  std::snprintf(text, sizeof text, std::abs(mm) < 0.1 ? "%.3g um" : "%.4g mm", std::abs(mm) < 0.1 ? mm * 1e3 : mm);
  return text;
}

std::string errors(const json& e) {
  return "rms " + length(e["rms"]) + ", 95 % below " + length(e["p95"]) + ", largest " + length(e["max"]);
}

constexpr double kDegrees = 180 / std::numbers::pi;

std::string surface_line(const json& surface) {
  return line("  surface     %s, degree (%d, %d), %d x %d control points", surface["model"].get<std::string>().c_str(),
              surface["degree"][0].get<int>(), surface["degree"][1].get<int>(), surface["control_points"][0].get<int>(),
              surface["control_points"][1].get<int>());
}

std::string coverage_line(const json& surface) {
  const double covered = 100 * surface["coverage"].get<double>();
  if (surface.contains("band_rad")) {
    return line("  coverage    %.1f %% of the band phi %.2f .. %.2f degrees", covered,
                surface["band_rad"][0].get<double>() * kDegrees, surface["band_rad"][1].get<double>() * kDegrees);
  }
  return line("  coverage    %.1f %% of the band z %.2f .. %.2f mm", covered, surface["band_mm"][0].get<double>(),
              surface["band_mm"][1].get<double>());
}

std::string joint_line(const json& joint) {
  return line(
      "  joint       z %.3f mm: tangent planes within %.2g degrees; alone the pieces met within %s and %.2g degrees",
      joint["height_mm"].get<double>(), joint["after"]["angle_rad"].get<double>() * kDegrees,
      length(joint["before"]["gap_mm"]).c_str(), joint["before"]["angle_rad"].get<double>() * kDegrees);
}

std::string shoulder_line(const json& shoulder) {
  const bool given = shoulder["sd_mm"].get<double>() == 0;
  return line("  shoulder    z %.4f mm (%s), the range steps by %.3f mm; within %s of it samples lie on neither wall",
              shoulder["height_mm"].get<double>(),
              given ? "as given" : ("standard deviation " + length(shoulder["sd_mm"])).c_str(),
              shoulder["jump_mm"].get<double>(), length(shoulder["edge_mm"]).c_str());
}

// What to expect of the scan, and of a better exposure.
std::string dry_turn_lines(const json& dry) {
  double dimmest = 255, brightest = 0;
  for (const json& sector : dry["sectors"]) {
    if (sector["rows"] == 0) continue;
    dimmest = std::min(dimmest, sector["amplitude"].get<double>());
    brightest = std::max(brightest, sector["amplitude"].get<double>());
  }
  std::string text = line("  the scan    of %d profiles a turn", dry["profiles"].get<int>());
  text.pop_back();
  if (dry.contains("seconds")) text += line(" takes about %.0f s,", dry["seconds"].get<double>()), text.pop_back();
  text += " will measure with a standard deviation of about " + length(dry["sd_mm"]) + "\n";
  text += line("  exposure    %.3g ms: the line has %.0f to %.0f grey levels, by sector",
               dry["exposure_ms"].get<double>(), dimmest, brightest);
  if (dry["better_exposure_ms"] != dry["exposure_ms"]) {
    text.pop_back();
    text += line("; %.3g ms is better", dry["better_exposure_ms"].get<double>());
  }
  return text;
}

// One line of counts, then a line for each check that failed.
std::string checks_lines(const json& list) {
  int passed = 0;
  std::string unknown, failed;
  for (const SelfCheck& check : self_checks_from_json(list)) {
    passed += check.verdict == CheckVerdict::passed;
    if (check.verdict == CheckVerdict::not_verifiable) unknown += (unknown.empty() ? "" : ", ") + check.name;
    if (check.verdict == CheckVerdict::failed) failed += "  CHECK FAILED " + sentence_of(check) + "\n";
  }
  return "  checks      " + std::to_string(passed) + " of " + std::to_string(list.size()) + " passed" +
         (unknown.empty() ? "" : "; not verifiable here: " + unknown) + "\n" + failed;
}

// What each of several lasers saw, and how well they agree.
std::string laser_lines(const json& report) {
  std::string text;
  const json lasers = report.value("lasers", json::array());
  if (lasers.size() > 1) {
    for (const auto& share : lasers) {
      char where[80] = "";
      if (share.contains("elevation_deg")) {
        std::snprintf(where, sizeof where, ", elevation %.2f degrees, lift %.2f mm",
                      share["elevation_deg"].get<double>(), share["lift_mm"].get<double>());
      }
      text += line("  laser       %d: %.2f M samples in %d profiles%s", share["laser"].get<int>(),
                   share["samples"].get<double>() / 1e6, share["profiles"].get<int>(), static_cast<const char*>(where));
    }
    if (report.contains("agreement_mm")) {
      const auto& agreement = report["agreement_mm"];
      text += "  agreement   laser " + agreement["lasers"][1].dump() + " minus laser " + agreement["lasers"][0].dump() +
              ": " + length(agreement["bias"]) + " on average, standard error " + length(agreement["bias_sd"]) +
              "; rms " + length(agreement["rms"]) + line(" in %d cells", agreement["cells"].get<int>());
    }
  }
  return text;
}

// The exposures that were found, where they were looked for.
std::string exposure_line(const json& report) {
  if (!report.contains("exposures")) return "";
  const json& exposures = report["exposures"];
  double shortest = 1e9, longest = 0;
  std::size_t changes = 0;
  for (const json& turn : exposures["turns"]) {
    const json& stretches = turn["stretches"];
    if (stretches.size() > 1) changes += stretches.size();
    for (const json& stretch : stretches) {
      shortest = std::min(shortest, stretch["exposure_ms"].get<double>());
      longest = std::max(longest, stretch["exposure_ms"].get<double>());
    }
  }
  return line("  exposure    %.3g to %.3g ms by the line's peaks, changed %zu times%s", shortest, longest, changes,
              exposures["bracketed"].get<bool>() ? "; bright and dark places in two turns" : "");
}

// What follows in every report: checks and warnings.
std::string closing_lines(const json& report) {
  std::string text = exposure_line(report);
  if (report.contains("checks")) text += checks_lines(report["checks"]);
  for (const auto& warning : report["warnings"]) text += "  note        " + warning.get<std::string>() + "\n";
  return text;
}

// A scan to which no surface was fitted.
std::string samples_summary(const json& report) {
  return line("  samples     %llu%s", static_cast<unsigned long long>(report["points"]),
              report["simulated"].get<bool>() ? "  (simulated)" : "") +
         laser_lines(report) + closing_lines(report);
}

}  // namespace

std::string summary_of(const json& report) {
  if (report.value("base", "") == "none") return samples_summary(report);
  std::string text;
  const auto& size = report["size_mm"];
  text += line("  size        %.2f x %.2f x %.2f mm%s", size[0].get<double>(), size[1].get<double>(),
               size[2].get<double>(), report["simulated"].get<bool>() ? "  (simulated)" : "");
  const bool composite = report.contains("pieces");
  if (composite) {
    for (const auto& piece : report["pieces"]) text += surface_line(piece);
  } else {
    text += surface_line(report);
  }
  if (report.contains("shape_reason")) text += "  shape       " + report["shape_reason"].get<std::string>() + "\n";
  if (report.contains("own_axis")) {
    const auto& frame = composite ? report["pieces"][0]["frame"] : report["frame"];
    const auto& origin = frame["origin"];
    const auto& z = frame["z"];
    text += line("  axis        through %.3f %.3f %.3f along %.5f %.5f %.5f", origin[0].get<double>(),
                 origin[1].get<double>(), origin[2].get<double>(), z[0].get<double>(), z[1].get<double>(),
                 z[2].get<double>());
    text += "              " + report["own_axis"]["reason"].get<std::string>() + "\n";
  }
  if (report.contains("turned_over")) {
    const auto& pose = report["turned_over"];
    text += line("  poses       two: %.0f %% of the second lie on the wall of the first within ",
                 100 * pose["overlap"].get<double>());
    text.pop_back();
    text += length(pose["scale_mm"]) + "; raised to " + length(pose["shift_sd_mm"]) + "\n";
  }
  for (const char* which : {"lower", "upper"})
    if (report.contains("flat_ends") && report["flat_ends"].contains(which)) {
      const auto& face = report["flat_ends"][which];
      text += line(
          "  face        the %s end is flat at z %.3f mm, %.2f degrees off square; %.1f %% of the samples lie on it",
          which, face["height_mm"].get<double>(), face["tilt_rad"].get<double>() * kDegrees,
          100 * face["share"].get<double>());
    }
  if (report.contains("raised")) {
    const auto& raised = report["raised"];
    text += line("  heights     two: raised by %.4f mm, standard deviation %.2g mm (said: %.4f mm)",
                 raised["lift_mm"].get<double>(), raised["sd_mm"].get<double>(), raised["asked_mm"].get<double>());
  }
  if (report.contains("symmetry")) {
    const auto& symmetry = report["symmetry"];
    text += line("  symmetry    %d-fold", symmetry["fold"].get<int>());
    if (symmetry.contains("mirror_plane_rad")) {
      text.pop_back();
      text += line(", mirrored at %.3f degrees", symmetry["mirror_plane_rad"].get<double>() * kDegrees);
    }
  }
  for (const auto& held : report.value("constraints", json::array())) {
    const bool angle = held.contains("held_rad");
    const double unit = angle ? kDegrees : 1;
    text += line("  held        %s; the samples alone have %.6g, standard deviation %.2g",
                 held["what"].get<std::string>().c_str(), held[angle ? "alone_rad" : "alone_mm"].get<double>() * unit,
                 held[angle ? "alone_sd_rad" : "alone_sd_mm"].get<double>() * unit);
  }
  if (report.contains("about_scanner_axis")) {
    const auto& there = report["about_scanner_axis"];
    text += line("              about the scanner's axis it would be %s with %d x %d control points",
                 there["model"].get<std::string>().c_str(), there["control_points"][0].get<int>(),
                 there["control_points"][1].get<int>());
  }
  if (!composite) text += line("  chosen      %s", report["decided_by"].get<std::string>().c_str());
  if (composite)
    for (const auto& joint : report["joints"]) text += joint_line(joint);
  for (const auto& shoulder : report.value("shoulders", json::array())) text += shoulder_line(shoulder);
  text += line("  samples     %llu, of which %llu rejected and %.2f %% that no single-valued surface can follow",
               static_cast<unsigned long long>(report["points"]), static_cast<unsigned long long>(report["rejected"]),
               100.0 * report["unfollowable"].get<double>() / std::max(1.0, report["points"].get<double>()));
  text += laser_lines(report);
  text +=
      "  noise       " + length(report["noise_mm"]) + line(" (correlation factor %.2f)", report["kappa"].get<double>());
  text += "  fit error   " + errors(report["geometric_mm"]) + " (perpendicular)\n";
  if (report.contains("sd_mm")) {
    text += "  uncertainty standard deviation of the surface along the ray " + length(report["sd_mm"]["mean"]) +
            " on average, at most " + length(report["sd_mm"]["max"]) + "\n";
  }
  if (composite) {
    for (const auto& piece : report["pieces"]) text += coverage_line(piece);
  } else {
    text += coverage_line(report);
  }
  if (report.contains("truth_mm") && report["truth_mm"].is_object()) {
    const auto& truth = report["truth_mm"];
    text += "  truth       bias " + length(truth["bias"]) + ", rms " + length(truth["rms"]) + ", largest " +
            length(truth["max"]) + " against the simulator's object\n";
  }
  if (report.contains("solid") && report["solid"].is_object()) {
    text += line("  solid       %s, %d faces, %.2f cm3", report["solid"]["valid"].get<bool>() ? "valid" : "NOT VALID",
                 report["solid"]["faces"].get<int>(), report["solid"]["volume_mm3"].get<double>() / 1000);
  }
  if (report.contains("shell") && report["shell"].is_object()) {
    text += line("  shell       %s, %d face, open around: no solid",
                 report["shell"]["valid"].get<bool>() ? "valid" : "NOT VALID", report["shell"]["faces"].get<int>());
  }
  if (report.contains("dimensions")) {
    for (const auto& d : report["dimensions"]) {
      text += line("  %-11s %.4f mm, known to %.4f mm (k = 2)", d["name"].get<std::string>().c_str(),
                   d["value"].get<double>(), 2 * d["standard_uncertainty"].get<double>());
    }
  }
  if (report.contains("dry_turn")) text += dry_turn_lines(report["dry_turn"]);
  return text + closing_lines(report);
}

}  // namespace celadon::cli
