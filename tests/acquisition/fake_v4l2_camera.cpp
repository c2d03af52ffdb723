#include "tests/acquisition/fake_v4l2_camera.h"

#include <gtest/gtest.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstring>

namespace celadon {
namespace {

constexpr std::uint32_t kTime = V4L2_CID_EXPOSURE_ABSOLUTE, kAuto = V4L2_CID_EXPOSURE_AUTO;
constexpr std::uint32_t kBuffers = 8, kPlanes = 2, kRoom = 8192;  // of a plane in the file: whole pages

std::uint32_t place_in_file(std::uint32_t buffer, std::uint32_t plane) {
  return (buffer * kPlanes + plane) * kRoom;
}

}  // namespace

FakeCamera* FakeCamera::present = nullptr;

FakeCamera::FakeCamera() : name_("/tmp/celadon-camera-XXXXXX") {
  fd_ = ::mkstemp(name_.data());
  EXPECT_EQ(::ftruncate(fd_, place_in_file(kBuffers, 0)), 0);
  present = this;
}

FakeCamera::~FakeCamera() {
  present = nullptr;
  ::close(fd_);
  ::unlink(name_.c_str());
}

std::unique_ptr<FrameSource> FakeCamera::open(const std::string& options) const {
  auto source = open_frame_source(address() + options);
  EXPECT_TRUE(source) << source.error().message;
  return source ? std::move(*source) : nullptr;
}

bool FakeCamera::is(int fd) const {
  struct stat mine {
  }, theirs{};
  return ::fstat(fd_, &mine) == 0 && ::fstat(fd, &theirs) == 0 && mine.st_ino == theirs.st_ino &&
         mine.st_dev == theirs.st_dev;
}

v4l2_buf_type FakeCamera::type() const {
  return planes == 0 ? V4L2_BUF_TYPE_VIDEO_CAPTURE : V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE;
}

bool FakeCamera::is_automatic() const {
  const auto mode = controls.find(kAuto);
  return mode != controls.end() &&
         (mode->second == V4L2_EXPOSURE_AUTO || mode->second == V4L2_EXPOSURE_APERTURE_PRIORITY);
}

std::uint32_t FakeCamera::plane_bytes(std::uint32_t plane) const {
  if (plane > 0) return kFrameBytes / 2;
  const bool packed = fourcc == V4L2_PIX_FMT_YUYV || fourcc == V4L2_PIX_FMT_UYVY;
  return data_offset + (packed ? 2 * kFrameBytes : fourcc == V4L2_PIX_FMT_NV12 ? kFrameBytes * 3 / 2 : kFrameBytes);
}

void FakeCamera::describe(v4l2_format& format) const {
  const auto say = [this](auto& pixels) {
    pixels = {};
    pixels.width = kWidth;
    pixels.height = kHeight;
    pixels.pixelformat = fourcc;
    pixels.field = V4L2_FIELD_NONE;
    pixels.colorspace = V4L2_COLORSPACE_REC709;
  };
  if (planes == 0) {
    say(format.fmt.pix);
    format.fmt.pix.bytesperline = plane_bytes(0) == 2 * kFrameBytes ? 2 * kWidth : kWidth;
    format.fmt.pix.sizeimage = plane_bytes(0);
    return;
  }
  say(format.fmt.pix_mp);
  format.fmt.pix_mp.num_planes = static_cast<std::uint8_t>(planes);
  for (std::uint32_t i = 0; i < planes; ++i) {
    format.fmt.pix_mp.plane_fmt[i].bytesperline = kWidth;
    format.fmt.pix_mp.plane_fmt[i].sizeimage = plane_bytes(i);
  }
}

void FakeCamera::describe(v4l2_buffer& buffer) const {
  buffer.flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
  if (planes == 0) {
    buffer.length = plane_bytes(0);
    buffer.m.offset = place_in_file(buffer.index, 0);
    return;
  }
  for (std::uint32_t i = 0; i < planes; ++i) {
    buffer.m.planes[i].length = plane_bytes(i);
    buffer.m.planes[i].m.mem_offset = place_in_file(buffer.index, i);
  }
  buffer.length = told_planes != 0 ? told_planes : planes;
}

int FakeCamera::take(const v4l2_buffer& buffer) {
  if (maps_nothing && buffer.memory != V4L2_MEMORY_USERPTR) return EINVAL;
  if (planes != 0 && buffer.length < planes) return EINVAL;
  std::vector<Place> places;
  for (std::uint32_t i = 0; i < plane_count(); ++i) {
    const Place place = planes == 0 ? Place{buffer.m.userptr, buffer.length}
                                    : Place{buffer.m.planes[i].m.userptr, buffer.m.planes[i].length};
    if (maps_nothing && place.bytes < plane_bytes(i)) return EINVAL;
    places.push_back(place);
  }
  places_[buffer.index] = places;
  queued_.push_back(buffer.index);
  return 0;
}

int FakeCamera::fill(v4l2_buffer& buffer) {
  if (queued_.empty()) return EAGAIN;
  buffer.index = queued_.front();
  queued_.erase(queued_.begin());
  buffer.sequence = sequence_++;
  buffer.timestamp = {.tv_sec = stamp_ns / 1'000'000'000, .tv_usec = stamp_ns % 1'000'000'000 / 1000};
  buffer.flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
  for (std::uint32_t i = 0; i < plane_count(); ++i) {
    const auto pixel = static_cast<std::uint8_t>(buffer.sequence);
    std::vector<std::uint8_t> bytes(plane_bytes(i), static_cast<std::uint8_t>(255 - pixel));
    if (i == 0) std::memset(bytes.data() + data_offset, pixel, kFrameBytes);
    if (i == 0 && !content.empty()) bytes = content;
    if (maps_nothing) {
      std::memcpy(reinterpret_cast<void*>(places_[buffer.index][i].address), bytes.data(), bytes.size());
    } else {
      EXPECT_EQ(::pwrite(fd_, bytes.data(), bytes.size(), place_in_file(buffer.index, i)),
                static_cast<ssize_t>(bytes.size()));
    }
    const std::uint32_t used = told_used != 0 ? told_used : plane_bytes(i);
    if (planes == 0) {
      buffer.bytesused = used;
    } else {
      buffer.m.planes[i].bytesused = used;
      buffer.m.planes[i].data_offset = i == 0 ? data_offset : 0;
    }
  }
  if (told_index != 0) buffer.index = told_index;
  return 0;
}

int FakeCamera::answer(unsigned long request, void* argument) {
  if (unplugged) return ENODEV;
  if (failing.contains(request)) return EIO;
  switch (request) {
    case VIDIOC_QUERYCAP: {
      auto& capability = *static_cast<v4l2_capability*>(argument);
      capability.capabilities =
          (planes == 0 ? V4L2_CAP_VIDEO_CAPTURE : V4L2_CAP_VIDEO_CAPTURE_MPLANE) | V4L2_CAP_STREAMING;
      std::snprintf(reinterpret_cast<char*>(capability.card), sizeof capability.card, "Fake");
      return 0;
    }
    case VIDIOC_ENUM_FMT: {
      auto& format = *static_cast<v4l2_fmtdesc*>(argument);
      if (format.type != type() || format.index != 0) return EINVAL;
      format.pixelformat = fourcc;
      return 0;
    }
    case VIDIOC_G_FMT:
    case VIDIOC_S_FMT: {
      auto& format = *static_cast<v4l2_format*>(argument);
      if (format.type != type()) return EINVAL;
      describe(format);
      return 0;
    }
    case VIDIOC_S_PARM:
      return static_cast<v4l2_streamparm*>(argument)->type == type() ? 0 : EINVAL;
    case VIDIOC_REQBUFS:
    case VIDIOC_QUERYBUF:
    case VIDIOC_QBUF:
    case VIDIOC_DQBUF:
    case VIDIOC_STREAMON:
    case VIDIOC_STREAMOFF:
      return answer_stream(request, argument);
    default:
      return answer_control(request, argument);
  }
}

int FakeCamera::answer_stream(unsigned long request, void* argument) {
  if (request == VIDIOC_STREAMON || request == VIDIOC_STREAMOFF) {
    if (request == VIDIOC_STREAMOFF) queued_.clear();
    return *static_cast<int*>(argument) == static_cast<int>(type()) ? 0 : EINVAL;
  }
  if (request == VIDIOC_REQBUFS) {
    const auto& wanted = *static_cast<v4l2_requestbuffers*>(argument);
    if (wanted.type != type() || (maps_nothing && wanted.memory != V4L2_MEMORY_USERPTR)) return EINVAL;
    queued_.clear();
    return 0;
  }
  auto& buffer = *static_cast<v4l2_buffer*>(argument);
  // The kernel refuses an array with fewer planes than the format has.
  if (buffer.type != type() || (planes != 0 && (buffer.m.planes == nullptr || buffer.length < planes))) return EINVAL;
  if (request == VIDIOC_QBUF) return take(buffer);
  if (request == VIDIOC_DQBUF) return fill(buffer);
  describe(buffer);
  return 0;
}

int FakeCamera::answer_control(unsigned long request, void* argument) {
  switch (request) {
    case VIDIOC_QUERYCTRL: {
      auto& query = *static_cast<v4l2_queryctrl*>(argument);
      if (!controls.contains(query.id)) return EINVAL;
      query.minimum = 3;
      query.maximum = 2047;
      return 0;
    }
    case VIDIOC_QUERY_EXT_CTRL: {
      auto& query = *static_cast<v4l2_query_ext_ctrl*>(argument);
      const auto next = controls.upper_bound(query.id & ~V4L2_CTRL_FLAG_NEXT_CTRL);
      if (next == controls.end()) return EINVAL;
      query = {};
      query.id = next->first;
      query.type = V4L2_CTRL_TYPE_INTEGER;
      query.maximum = 2047;
      std::snprintf(query.name, sizeof query.name, "%s", names.contains(next->first) ? names.at(next->first) : "Other");
      return 0;
    }
    case VIDIOC_G_CTRL: {
      auto& control = *static_cast<v4l2_control*>(argument);
      if (!controls.contains(control.id)) return EINVAL;
      if (unreadable == control.id) return EIO;
      control.value = controls.at(control.id);
      return 0;
    }
    case VIDIOC_S_CTRL: {
      const auto& control = *static_cast<v4l2_control*>(argument);
      if (!controls.contains(control.id)) return EINVAL;
      order.push_back(control.id);
      if (control.id == kTime && is_automatic()) return EACCES;
      if (control.id == kTime && (control.value < 3 || control.value > 2047)) return ERANGE;
      if (unwritable == control.id) return EIO;
      controls.at(control.id) = control.value - control.value % step;
      return 0;
    }
    default:
      return ENOTTY;
  }
}

}  // namespace celadon

extern "C" int ioctl(int fd, unsigned long request, ...) noexcept {
  va_list arguments;
  va_start(arguments, request);
  void* argument = va_arg(arguments, void*);
  va_end(arguments);
  auto* const camera = celadon::FakeCamera::present;
  if (camera == nullptr || !camera->is(fd)) return static_cast<int>(::syscall(SYS_ioctl, fd, request, argument));
  errno = camera->answer(request, argument);
  return errno == 0 ? 0 : -1;
}
