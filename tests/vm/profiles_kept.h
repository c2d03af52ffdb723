#pragma once
// What the tests of interrupted scans look at.

#include <cstdint>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <string>

#include "tests/integration/process.h"

namespace celadon::testing {

/// Profiles in the logs of a store (daemon/PROFILE_LOG.md).
inline int profiles_kept(const std::filesystem::path& store) {
  int profiles = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(store)) {
    if (entry.path().filename() != "profiles.log") continue;
    const std::string log = read_file(entry.path());
    const auto u32 = [&](std::size_t at) {
      std::uint32_t value = 0;
      std::memcpy(&value, log.data() + at, sizeof value);
      return value;
    };
    for (std::size_t at = 16; at + 24 <= log.size(); at += 24 + (u32(at + 8) + 7) / 8 * 8) {
      if ((u32(at + 4) & 0xffff) == 3) ++profiles;
    }
  }
  return profiles;
}

/// For the seconds that a test prints.
inline double seconds_now() {
  timespec t{};
  clock_gettime(CLOCK_MONOTONIC, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

}  // namespace celadon::testing
