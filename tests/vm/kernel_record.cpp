#include "tests/vm/kernel_record.h"

#include <sys/ioctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cstdarg>

extern "C" int ioctl(int fd, unsigned long request, ...) noexcept {
  va_list arguments;
  va_start(arguments, request);
  void* argument = va_arg(arguments, void*);
  va_end(arguments);
  const auto answer = static_cast<int>(::syscall(SYS_ioctl, fd, request, argument));
  if (answer == 0 && request == VIDIOC_DQBUF) {
    const auto& buffer = *static_cast<v4l2_buffer*>(argument);
    const bool multi_planar = buffer.type == V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE;
    celadon::dequeued_buffers().push_back({buffer, multi_planar ? buffer.m.planes[0].data_offset : 0});
  }
  return answer;
}
