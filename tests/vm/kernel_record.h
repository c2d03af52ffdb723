#pragma once
// What the kernel said: every buffer that this process dequeued, recorded between the source under test and the kernel
// by an ioctl() of our own. In one source file of a test only.

#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cstdarg>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

namespace celadon {

inline std::vector<v4l2_buffer>& dequeued_buffers() {
  static std::vector<v4l2_buffer> buffers;
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

extern "C" int ioctl(int fd, unsigned long request, ...) noexcept {
  va_list arguments;
  va_start(arguments, request);
  void* argument = va_arg(arguments, void*);
  va_end(arguments);
  const auto answer = static_cast<int>(::syscall(SYS_ioctl, fd, request, argument));
  if (answer == 0 && request == VIDIOC_DQBUF) {
    celadon::dequeued_buffers().push_back(*static_cast<v4l2_buffer*>(argument));
  }
  return answer;
}
