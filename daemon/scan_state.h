#pragma once
// Scan states: one list for code, protocol, API and page.

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace celadon {

enum class ScanState : std::uint8_t {
  idle,
  queued,
  preparing,
  scanning,
  paused,
  solving,
  exporting,
  done,
  failed,
  cancelled,
  interrupted
};

const char* to_string(ScanState state);
std::optional<ScanState> scan_state_from(std::string_view text);
inline bool is_final(ScanState s) {
  return s == ScanState::done || s == ScanState::failed || s == ScanState::cancelled || s == ScanState::interrupted;
}

/// Whose fault a failed scan was: decides exit codes.
enum class ScanFailure : std::uint8_t {
  device,  ///< machine, camera, or what stood before them
  data,    ///< no surface fits what was measured
  system   ///< no space, no memory, a folder that cannot be written
};
const char* to_string(ScanFailure failure);
std::optional<ScanFailure> scan_failure_from(std::string_view text);

}  // namespace celadon
