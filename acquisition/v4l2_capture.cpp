#include "acquisition/v4l2_capture.h"

#include <algorithm>

#include "acquisition/v4l2_ioctl.h"

namespace celadon {
namespace {

std::uint32_t abilities_of(const v4l2_capability& capability) {
  return (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? capability.device_caps : capability.capabilities;
}

V4l2Picture picture_of(const v4l2_format& format) {
  if (format.type == V4L2_BUF_TYPE_VIDEO_CAPTURE) {
    const v4l2_pix_format& pixels = format.fmt.pix;
    return {pixels.width,      pixels.height,    pixels.pixelformat,  pixels.field,
            pixels.colorspace, pixels.ycbcr_enc, pixels.quantization, {{pixels.bytesperline, pixels.sizeimage}}};
  }
  const v4l2_pix_format_mplane& pixels = format.fmt.pix_mp;
  V4l2Picture picture{pixels.width,      pixels.height,    pixels.pixelformat,  pixels.field,
                      pixels.colorspace, pixels.ycbcr_enc, pixels.quantization, {}};
  for (unsigned i = 0; i < std::min<unsigned>(pixels.num_planes, VIDEO_MAX_PLANES); ++i)
    picture.planes.push_back({pixels.plane_fmt[i].bytesperline, pixels.plane_fmt[i].sizeimage});
  return picture;
}

}  // namespace

std::optional<v4l2_buf_type> capture_type_of(const v4l2_capability& capability) {
  const std::uint32_t can = abilities_of(capability);
  if ((can & V4L2_CAP_VIDEO_CAPTURE) != 0) return V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if ((can & V4L2_CAP_VIDEO_CAPTURE_MPLANE) != 0) return V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE;
  return std::nullopt;
}

bool can_stream(const v4l2_capability& capability) {
  return (abilities_of(capability) & V4L2_CAP_STREAMING) != 0;
}

int read_picture(int fd, v4l2_buf_type type, V4l2Picture& picture) {
  v4l2_format format{};
  format.type = type;
  const int code = v4l2_ioctl(fd, VIDIOC_G_FMT, &format);
  if (code == 0) picture = picture_of(format);
  return code;
}

int set_picture(int fd, v4l2_buf_type type, V4l2Picture& picture) {
  // Stride and size stay 0: one left over from another format would be kept by some drivers.
  v4l2_format format{};
  format.type = type;
  const auto ask = [&](auto& pixels) {
    pixels.width = picture.width_px;
    pixels.height = picture.height_px;
    pixels.pixelformat = picture.fourcc;
    pixels.field = V4L2_FIELD_NONE;
  };
  if (type == V4L2_BUF_TYPE_VIDEO_CAPTURE) {
    ask(format.fmt.pix);
  } else {
    ask(format.fmt.pix_mp);
  }
  const int code = v4l2_ioctl(fd, VIDIOC_S_FMT, &format);
  if (code == 0) picture = picture_of(format);
  return code;
}

}  // namespace celadon
