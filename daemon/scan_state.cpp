#include "daemon/scan_state.h"

#include <array>

namespace celadon {
namespace {

constexpr std::array<const char*, 11> kNames = {"idle",   "queued",    "preparing",  "scanning",
                                                "paused", "solving",   "exporting",  "done",
                                                "failed", "cancelled", "interrupted"};

constexpr std::array<const char*, 3> kFailures = {"device", "data", "system"};

template <class Name, std::size_t n>
std::optional<Name> named(const std::array<const char*, n>& names, std::string_view text) {
  for (std::size_t i = 0; i < n; ++i) {
    if (text == names.at(i)) return static_cast<Name>(i);
  }
  return std::nullopt;
}

}  // namespace

const char* to_string(ScanState state) {
  return kNames.at(static_cast<std::size_t>(state));
}

std::optional<ScanState> scan_state_from(std::string_view text) {
  return named<ScanState>(kNames, text);
}

const char* to_string(ScanFailure failure) {
  return kFailures.at(static_cast<std::size_t>(failure));
}

std::optional<ScanFailure> scan_failure_from(std::string_view text) {
  return named<ScanFailure>(kFailures, text);
}

}  // namespace celadon
