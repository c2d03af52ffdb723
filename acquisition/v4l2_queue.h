#pragma once
// The buffers of a V4L2 capture device: memory of the driver's, mapped, or of ours where a driver maps none; queued,
// streamed, dequeued. One place for both interfaces, single-planar and multi-planar.

#include <linux/videodev2.h>

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/frame.h"

namespace celadon {

/// A buffer that the driver filled and gave back.
struct FilledBuffer {
  std::uint32_t index = 0, sequence = 0, flags = 0;  ///< flags: V4L2_BUF_FLAG_...
  std::int64_t stamp_ns = 0;
  /// Of the first plane, from where the picture begins to the end of the plane's memory; at least what open() asked
  /// for.
  std::span<const std::uint8_t> memory;
  std::size_t used_bytes = 0;  ///< of `memory`, by the picture
};

class V4l2Queue {
 public:
  struct Device {
    int fd;  ///< non-blocking; must stay open as long as the queue
    v4l2_buf_type type;
    std::string path, name;  ///< name: as errors have it
  };

  /// Has buffers made and maps them; nothing streams yet.
  /// @param plane_bytes  of each plane of the format, at most
  /// @param least_bytes  of the first plane, for a whole frame
  static tl::expected<std::unique_ptr<V4l2Queue>, CameraError> open(Device device,
                                                                    std::span<const std::uint32_t> plane_bytes,
                                                                    std::size_t least_bytes);
  /// Stops the stream and frees the buffers. Every step is tried: a device that is gone fails them all, and the memory
  /// is unmapped all the same.
  ~V4l2Queue();
  V4l2Queue(const V4l2Queue&) = delete;
  V4l2Queue& operator=(const V4l2Queue&) = delete;

  /// Gives the driver all buffers, then starts the stream.
  tl::expected<void, CameraError> start();
  /// The oldest filled buffer, waiting at most timeout_ns of the host clock (Kind::timed_out: the dequeue watchdog). It
  /// is the caller's until give().
  tl::expected<FilledBuffer, CameraError> next(std::int64_t timeout_ns);
  /// Gives the driver a buffer to fill. @returns 0 or the errno
  int give(std::uint32_t index);

  std::size_t size() const { return buffers_.size(); }
  /// V4L2_BUF_FLAG_... of a buffer that was never filled: which clock stamps, and at what event.
  std::uint32_t flags() const { return flags_; }

 private:
  struct Memory {
    void* address;
    std::size_t size;
  };
  /// A v4l2_buffer with the planes that it points to.
  struct Request;

  V4l2Queue(Device device, std::size_t least_bytes) : device_(std::move(device)), least_bytes_(least_bytes) {}
  bool multi_planar() const { return device_.type == V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE; }
  int request_buffers(std::uint32_t& count);
  tl::expected<void, CameraError> make_buffers(std::span<const std::uint32_t> plane_bytes);
  tl::expected<void, CameraError> map(std::uint32_t index, std::span<const std::uint32_t> plane_bytes);
  tl::expected<FilledBuffer, CameraError> filled(const Request& request) const;
  tl::unexpected<CameraError> fault(const std::string& operation, int code, const std::string& remedy) const;
  tl::unexpected<CameraError> driver_fault(const std::string& operation, const std::string& cause) const;

  Device device_;
  std::size_t least_bytes_;
  v4l2_memory memory_ = V4L2_MEMORY_MMAP;
  std::vector<std::vector<Memory>> buffers_;  ///< the planes of each
  std::uint32_t flags_ = 0;
  bool requested_ = false, streaming_ = false;
};

}  // namespace celadon
