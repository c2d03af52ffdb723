#pragma once
// The controls of the kernel's vivid driver by which tests inject faults, found by their names.

#include <fcntl.h>
#include <gtest/gtest.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <cstring>
#include <string>

namespace celadon {

class VividControls {
 public:
  explicit VividControls(const std::string& device) : fd_(::open(device.c_str(), O_RDWR)) {
    EXPECT_GE(fd_, 0) << device << ": " << std::strerror(errno);
  }
  VividControls(const VividControls&) = delete;
  VividControls& operator=(const VividControls&) = delete;
  ~VividControls() { ::close(fd_); }

  void set(const char* name, int value = 1) const {
    v4l2_queryctrl query{};
    for (query.id = V4L2_CTRL_FLAG_NEXT_CTRL; ::ioctl(fd_, VIDIOC_QUERYCTRL, &query) == 0;
         query.id |= V4L2_CTRL_FLAG_NEXT_CTRL) {
      if (std::strcmp(reinterpret_cast<const char*>(query.name), name) != 0) continue;
      v4l2_control control{.id = query.id, .value = value};
      EXPECT_EQ(::ioctl(fd_, VIDIOC_S_CTRL, &control), 0) << name << ": " << std::strerror(errno);
      return;
    }
    ADD_FAILURE() << "vivid has no control \"" << name << "\"";
  }

 private:
  int fd_;
};

}  // namespace celadon
