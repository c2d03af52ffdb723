#pragma once
// What a capture device is set to deliver, through the single-planar or the multi-planar interface of V4L2.

#include <linux/videodev2.h>

#include <cstdint>
#include <optional>
#include <vector>

namespace celadon {

/// How a device captures video: V4L2_BUF_TYPE_VIDEO_CAPTURE or V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE. Nothing: it does
/// not.
std::optional<v4l2_buf_type> capture_type_of(const v4l2_capability& capability);
/// Its buffers are streamed.
bool can_stream(const v4l2_capability& capability);

struct V4l2Picture {
  /// A part of the picture with memory of its own.
  struct Plane {
    std::uint32_t stride_bytes = 0, bytes = 0;  ///< distance of rows; of the plane at most
  };
  std::uint32_t width_px = 0, height_px = 0, fourcc = 0;
  std::uint32_t field = 0, colorspace = 0, ycbcr_encoding = 0, quantization = 0;
  std::vector<Plane> planes;  ///< one, but for formats with several in devices with several
};

/// What the device is set to. @returns 0 or the errno
int read_picture(int fd, v4l2_buf_type type, V4l2Picture& picture);
/// Asks for width, height, format and whole frames; strides and sizes are the driver's to choose. `picture` then has
/// what the device is set to. @returns 0 or the errno
int set_picture(int fd, v4l2_buf_type type, V4l2Picture& picture);

}  // namespace celadon
