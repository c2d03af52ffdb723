#include "acquisition/v4l2_queue.h"

#include <poll.h>
#include <sys/mman.h>

#include <algorithm>
#include <array>
#include <cerrno>

#include "acquisition/camera_fault.h"
#include "acquisition/monotonic_clock.h"
#include "acquisition/v4l2_fault.h"
#include "acquisition/v4l2_ioctl.h"

namespace celadon {
namespace {

using Kind = CameraError::Kind;

/// Enough that a frame or two can be held back until the table's angle is known while the driver fills others.
constexpr std::uint32_t kBuffers = 8;
constexpr std::uint32_t kFewestBuffers = 2;
constexpr const char* kGetting = "getting frame buffers";
constexpr const char* kWaiting = "waiting for a frame";

}  // namespace

struct V4l2Queue::Request {
  explicit Request(const V4l2Queue& queue, std::uint32_t index = 0) {
    buffer.type = queue.device_.type;
    buffer.memory = queue.memory_;
    buffer.index = index;
    if (!queue.multi_planar()) return;
    buffer.m.planes = planes.data();
    buffer.length = static_cast<std::uint32_t>(planes.size());
  }
  Request(const Request&) = delete;
  Request& operator=(const Request&) = delete;

  v4l2_buffer buffer{};
  std::array<v4l2_plane, VIDEO_MAX_PLANES> planes{};
};

tl::unexpected<CameraError> V4l2Queue::fault(const std::string& operation, int code, const std::string& remedy) const {
  return tl::unexpected(v4l2_fault(device_.name, operation, code, remedy));
}

tl::unexpected<CameraError> V4l2Queue::driver_fault(const std::string& operation, const std::string& cause) const {
  return tl::unexpected(camera_fault(Kind::protocol, device_.name, operation, cause,
                                     "this is a fault of the driver: use another format"));
}

tl::expected<std::unique_ptr<V4l2Queue>, CameraError> V4l2Queue::open(Device device,
                                                                      std::span<const std::uint32_t> plane_bytes,
                                                                      std::size_t least_bytes) {
  std::unique_ptr<V4l2Queue> queue(new V4l2Queue(std::move(device), least_bytes));
  if (auto made = queue->make_buffers(plane_bytes); !made) return tl::unexpected(std::move(made.error()));
  return queue;
}

V4l2Queue::~V4l2Queue() {
  int type = static_cast<int>(device_.type);
  if (streaming_) v4l2_ioctl(device_.fd, VIDIOC_STREAMOFF, &type);
  for (const std::vector<Memory>& planes : buffers_)
    for (const Memory& plane : planes) ::munmap(plane.address, plane.size);
  std::uint32_t none = 0;
  if (requested_) request_buffers(none);
}

int V4l2Queue::request_buffers(std::uint32_t& count) {
  v4l2_requestbuffers request{};
  request.count = count;
  request.type = device_.type;
  request.memory = memory_;
  const int code = v4l2_ioctl(device_.fd, VIDIOC_REQBUFS, &request);
  count = request.count;
  return code;
}

tl::expected<void, CameraError> V4l2Queue::make_buffers(std::span<const std::uint32_t> plane_bytes) {
  std::uint32_t count = kBuffers;
  int code = request_buffers(count);
  if (code == EINVAL) {
    memory_ = V4L2_MEMORY_USERPTR;
    count = kBuffers;
    code = request_buffers(count);
  }
  if (code != 0) {
    return fault(kGetting, code,
                 code == EBUSY ? close_other_user_of(device_.path) : "free some memory or use a smaller size");
  }
  requested_ = true;
  if (count < kFewestBuffers) {
    return tl::unexpected(camera_fault(Kind::unsupported, device_.name, kGetting,
                                       "the driver gave " + std::to_string(count) + " and streaming needs 2",
                                       "free some memory or use a smaller size"));
  }
  for (std::uint32_t i = 0; i < count; ++i)
    if (auto mapped = map(i, plane_bytes); !mapped) return mapped;
  return {};
}

tl::expected<void, CameraError> V4l2Queue::map(std::uint32_t index, std::span<const std::uint32_t> plane_bytes) {
  Request asked(*this, index);
  if (const int code = v4l2_ioctl(device_.fd, VIDIOC_QUERYBUF, &asked.buffer); code != 0) {
    return fault(kGetting, code, "try another camera");
  }
  flags_ = asked.buffer.flags;
  if (multi_planar() && asked.buffer.length != plane_bytes.size()) {
    return driver_fault(kGetting, "a buffer has " + std::to_string(asked.buffer.length) + " planes and the format " +
                                      std::to_string(plane_bytes.size()));
  }
  std::vector<Memory>& planes = buffers_.emplace_back();
  for (std::size_t i = 0; i < plane_bytes.size(); ++i) {
    const bool driver_s = memory_ == V4L2_MEMORY_MMAP;
    const std::size_t length = multi_planar() ? asked.planes[i].length : asked.buffer.length;
    const std::size_t size = driver_s ? length : plane_bytes[i];
    if (const std::size_t least = i == 0 ? least_bytes_ : 1; size < least) {
      return driver_fault(kGetting,
                          "a buffer has " + std::to_string(size) + " bytes and a frame " + std::to_string(least));
    }
    const std::uint32_t offset = multi_planar() ? asked.planes[i].m.mem_offset : asked.buffer.m.offset;
    void* const address = driver_s
                              ? ::mmap(nullptr, size, PROT_READ, MAP_SHARED, device_.fd, static_cast<off_t>(offset))
                              : ::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (address == MAP_FAILED) return fault("mapping frame buffers", errno, "free some memory");
    planes.push_back({address, size});
  }
  return {};
}

tl::expected<void, CameraError> V4l2Queue::start() {
  int code = 0;
  for (std::uint32_t i = 0; i < buffers_.size() && code == 0; ++i) code = give(i);
  int type = static_cast<int>(device_.type);
  if (code == 0) code = v4l2_ioctl(device_.fd, VIDIOC_STREAMON, &type);
  if (code == 0) {
    streaming_ = true;
    return {};
  }
  return fault("starting the stream", code,
               code == ENOSPC  ? "the USB bus has no room for this format: use a smaller size or another port"
               : code == EBUSY ? close_other_user_of(device_.path)
                               : "unplug the camera and connect it again");
}

int V4l2Queue::give(std::uint32_t index) {
  Request request(*this, index);
  const std::vector<Memory>& planes = buffers_[index];
  if (multi_planar()) request.buffer.length = static_cast<std::uint32_t>(planes.size());
  for (std::size_t i = 0; i < planes.size() && memory_ == V4L2_MEMORY_USERPTR; ++i) {
    const auto address = reinterpret_cast<unsigned long>(planes[i].address);
    const auto size = static_cast<std::uint32_t>(planes[i].size);
    if (multi_planar()) {
      request.planes[i].m.userptr = address;
      request.planes[i].length = size;
    } else {
      request.buffer.m.userptr = address;
      request.buffer.length = size;
    }
  }
  return v4l2_ioctl(device_.fd, VIDIOC_QBUF, &request.buffer);
}

tl::expected<FilledBuffer, CameraError> V4l2Queue::next(std::int64_t timeout_ns) {
  const std::int64_t deadline = monotonic_ns() + std::max<std::int64_t>(timeout_ns, 0);
  for (;;) {
    Request request(*this);
    const int code = v4l2_ioctl(device_.fd, VIDIOC_DQBUF, &request.buffer);
    if (code == 0) return filled(request);
    if (code != EAGAIN) return fault(kWaiting, code, "stop and start the camera; if it stays so, connect it again");
    const std::int64_t left = deadline - monotonic_ns();
    if (left <= 0) {
      return tl::unexpected(camera_fault(
          Kind::timed_out, device_.name, kWaiting,
          "no frame came within " + std::to_string(timeout_ns / 1'000'000) + " ms",
          "the stream has stalled: check the cable and the bus, then stop and start the camera", ETIMEDOUT));
    }
    // The queue's state is read again after every wait: an error or a hang-up shows in its answer, with its errno.
    const timespec wait{left / 1'000'000'000, left % 1'000'000'000};
    pollfd poll{.fd = device_.fd, .events = POLLIN, .revents = 0};
    if (::ppoll(&poll, 1, &wait, nullptr) < 0 && errno != EINTR) return fault(kWaiting, errno, "open the camera again");
    if ((poll.revents & (POLLERR | POLLHUP | POLLNVAL)) != 0) {
      Request last(*this);
      const int cause = v4l2_ioctl(device_.fd, VIDIOC_DQBUF, &last.buffer);
      if (cause == 0) return filled(last);
      // A queue in error that has nothing to say would make this loop spin.
      return fault(kWaiting, cause == EAGAIN ? EIO : cause,
                   "stop and start the camera; if it stays so, connect it again");
    }
  }
}

tl::expected<FilledBuffer, CameraError> V4l2Queue::filled(const Request& request) const {
  const v4l2_buffer& buffer = request.buffer;
  if (buffer.index >= buffers_.size()) {
    return driver_fault(kWaiting, "the driver named buffer " + std::to_string(buffer.index));
  }
  // Of several planes, what is before the picture counts as used.
  const std::size_t begin = multi_planar() ? request.planes[0].data_offset : 0;
  const std::size_t used = multi_planar() ? request.planes[0].bytesused : buffer.bytesused;
  const Memory& plane = buffers_[buffer.index].front();
  if (begin > plane.size || plane.size - begin < least_bytes_) {
    return driver_fault(kWaiting, "the driver's picture begins at byte " + std::to_string(begin) + " of " +
                                      std::to_string(plane.size) + " and needs " + std::to_string(least_bytes_));
  }
  FilledBuffer out;
  out.index = buffer.index;
  out.sequence = buffer.sequence;
  out.flags = buffer.flags;
  out.stamp_ns = std::int64_t{buffer.timestamp.tv_sec} * 1'000'000'000 + std::int64_t{buffer.timestamp.tv_usec} * 1000;
  out.memory = {static_cast<const std::uint8_t*>(plane.address) + begin, plane.size - begin};
  out.used_bytes = std::min(std::max(used, begin) - begin, out.memory.size());
  return out;
}

}  // namespace celadon
