#pragma once
#include <sys/ioctl.h>

#include <cerrno>

namespace celadon {

/// ioctl, again after a signal. @returns 0 or the errno
inline int v4l2_ioctl(int fd, unsigned long request, void* argument) {
  for (;;) {
    if (::ioctl(fd, request, argument) >= 0) return 0;
    if (errno != EINTR) return errno;
  }
}

}  // namespace celadon
