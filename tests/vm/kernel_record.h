#pragma once
// What the kernel said: every buffer that this process dequeued, recorded between the source under test and the kernel
// by an ioctl() of our own.

#include <linux/videodev2.h>

#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

namespace celadon {

/// What the kernel answered, but for where the planes of the multi-planar interface were told.
struct DequeuedBuffer : v4l2_buffer {
  std::uint32_t data_offset = 0;  ///< of the first plane
};

inline std::vector<DequeuedBuffer>& dequeued_buffers() {
  static std::vector<DequeuedBuffer> buffers;
  return buffers;
}

/// Whether a mapping of the device in this process begins at this address. (The kernel does not keep its offset.)
inline bool is_mapping(const std::string& device, const std::uint8_t* address) {
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line);) {
    if (line.find(device) == std::string::npos) continue;
    if (std::strtoull(line.c_str(), nullptr, 16) == reinterpret_cast<std::uintptr_t>(address)) return true;
  }
  return false;
}

}  // namespace celadon
