#include "daemon/cli/summary.h"

#include <cstdio>
#include <nlohmann/json.hpp>
#include <numbers>

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

}  // namespace

std::string summary_of(const json& report) {
  std::string text;
  const auto& size = report["size_mm"];
  text += line("  size        %.2f x %.2f x %.2f mm%s", size[0].get<double>(), size[1].get<double>(),
               size[2].get<double>(), report["simulated"].get<bool>() ? "  (simulated)" : "");
  text += line("  surface     %s, degree (%d, %d), %d x %d control points", report["model"].get<std::string>().c_str(),
               report["degree"][0].get<int>(), report["degree"][1].get<int>(), report["control_points"][0].get<int>(),
               report["control_points"][1].get<int>());
  if (report.contains("own_axis")) {
    const auto& origin = report["frame"]["origin"];
    const auto& z = report["frame"]["z"];
    text += line("  axis        through %.3f %.3f %.3f along %.5f %.5f %.5f", origin[0].get<double>(),
                 origin[1].get<double>(), origin[2].get<double>(), z[0].get<double>(), z[1].get<double>(),
                 z[2].get<double>());
    text += "              " + report["own_axis"]["reason"].get<std::string>() + "\n";
  }
  text += line("  chosen      %s", report["decided_by"].get<std::string>().c_str());
  text += line("  samples     %llu, of which %llu rejected and %.2f %% that no single-valued surface can follow",
               static_cast<unsigned long long>(report["points"]), static_cast<unsigned long long>(report["rejected"]),
               100.0 * report["unfollowable"].get<double>() / std::max(1.0, report["points"].get<double>()));
  text +=
      "  noise       " + length(report["noise_mm"]) + line(" (correlation factor %.2f)", report["kappa"].get<double>());
  text += "  fit error   " + errors(report["geometric_mm"]) + " (perpendicular)\n";
  const double covered = 100 * report["coverage"].get<double>();
  if (report.contains("band_rad")) {
    constexpr double kDegrees = 180 / std::numbers::pi;
    text += line("  coverage    %.1f %% of the band phi %.2f .. %.2f degrees", covered,
                 report["band_rad"][0].get<double>() * kDegrees, report["band_rad"][1].get<double>() * kDegrees);
  } else {
    text += line("  coverage    %.1f %% of the band z %.2f .. %.2f mm", covered, report["band_mm"][0].get<double>(),
                 report["band_mm"][1].get<double>());
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
  for (const auto& warning : report["warnings"]) text += "  note        " + warning.get<std::string>() + "\n";
  return text;
}

}  // namespace celadon::cli
