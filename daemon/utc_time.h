#pragma once
// The present date and time as files and records have it.

#include <ctime>
#include <string>

namespace celadon {

/// ISO 8601, UTC, to the second.
inline std::string utc_now() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  ::gmtime_r(&now, &parts);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text;
}

}  // namespace celadon
