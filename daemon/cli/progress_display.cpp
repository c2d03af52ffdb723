#include "daemon/cli/progress_display.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

namespace celadon::cli {

using nlohmann::json;

std::string progress_line(const json& scan) {
  const auto& p = scan["progress"];
  const double fraction = std::clamp(p.value("fraction", 0.0), 0.0, 1.0);
  std::string bar(30, '-');
  std::fill_n(bar.begin(), std::lround(fraction * 30), '#');
  char text[256];
  std::snprintf(text, sizeof text, "%-10s [%s] %5.1f deg  %4.0f fps  %6.2f M samples",
                scan["state"].get<std::string>().c_str(), bar.c_str(), p.value("angle_deg", 0.0),
                p.value("frames_per_second", 0.0), p.value("samples", 0.0) / 1e6);
  std::string line = text;
  if (p.contains("fit_rms_mm") && p["fit_rms_mm"].is_number()) {
    std::snprintf(text, sizeof text, "  fit %.1f um", 1e3 * p["fit_rms_mm"].get<double>());
    line += text;
  }
  const double left = p.value("seconds_left", 0.0);
  if (left > 0) {
    std::snprintf(text, sizeof text, "  %.0f s left", left);
    line += text;
  }
  return line;
}

ProgressDisplay::ProgressDisplay(bool as_json) : json_(as_json), terminal_(::isatty(STDOUT_FILENO) == 1) {}

ProgressDisplay::~ProgressDisplay() {
  if (line_open_) std::printf("\n");
}

void ProgressDisplay::show(const json& scan) {
  if (json_) {
    std::printf("%s\n", scan.dump().c_str());
    std::fflush(stdout);
    return;
  }
  const std::string state = scan["state"];
  const int tenth = static_cast<int>(scan["progress"].value("fraction", 0.0) * 10);
  if (terminal_) {
    std::printf("\r\033[K%s", progress_line(scan).c_str());
    line_open_ = true;
  } else if (state != last_state_ || tenth != last_tenth_) {
    std::printf("%s\n", progress_line(scan).c_str());
  }
  last_state_ = state;
  last_tenth_ = tenth;
  std::fflush(stdout);
}

}  // namespace celadon::cli
