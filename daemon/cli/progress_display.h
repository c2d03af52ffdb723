#pragma once
// Progress of a scan on a terminal (one line that rewrites itself), in a log (a line now and then) or as JSON lines.

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace celadon::cli {

class ProgressDisplay {
 public:
  /// as_json: every event as one line of JSON on standard output.
  explicit ProgressDisplay(bool as_json);
  ~ProgressDisplay();  ///< leaves the cursor on a line of its own
  /// A Scan object of openapi.yaml.
  void show(const nlohmann::json& scan);

 private:
  bool json_, terminal_, line_open_ = false;
  std::string last_state_;
  int last_tenth_ = -1;
};

/// "[#####-----] 181.2 deg  45 fps  ..." for a scan under way; the text alone.
std::string progress_line(const nlohmann::json& scan);

}  // namespace celadon::cli
