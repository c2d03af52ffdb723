#pragma once
#include <cerrno>
#include <cstring>
#include <string>

namespace celadon::sim {

/// "WHAT failed: ..." with the reason of the last system call.
inline std::string system_text(const std::string& what) {
  return what + " failed: " + std::strerror(errno);
}

}  // namespace celadon::sim
