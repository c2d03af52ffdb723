#pragma once
// The host's clock, which frames are stamped by.

#include <time.h>

#include <cstdint>

namespace celadon {

/// CLOCK_MONOTONIC.
inline std::int64_t monotonic_ns() {
  timespec t{};
  ::clock_gettime(CLOCK_MONOTONIC, &t);
  return std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec;
}

}  // namespace celadon
