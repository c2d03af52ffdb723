#include "daemon/scan_state.h"

#include <array>

namespace celadon {
namespace {

constexpr std::array<const char*, 11> kNames = {"idle",   "queued",    "preparing",  "scanning",
                                                "paused", "solving",   "exporting",  "done",
                                                "failed", "cancelled", "interrupted"};

}  // namespace

const char* to_string(ScanState state) {
  return kNames.at(static_cast<std::size_t>(state));
}

std::optional<ScanState> scan_state_from(std::string_view text) {
  for (std::size_t i = 0; i < kNames.size(); ++i) {
    if (text == kNames.at(i)) return static_cast<ScanState>(i);
  }
  return std::nullopt;
}

}  // namespace celadon
