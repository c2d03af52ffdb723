#include <string>

#include "sim/uvc_camera.h"

// Descriptors of the camera: USB Device Class Definition for Video Devices 1.0, section 3.

namespace celadon::sim {
namespace {

constexpr std::uint8_t kVideo = 0x0e, kControlInterface = 1, kStreamInterface = 2, kClassSpecific = 0x24;
constexpr std::uint32_t kClock_Hz = 48'000'000;

/// A format's GUID: its four characters, then the same for all.
void put_guid(Bytes& out, const std::string& fourcc) {
  for (const char c : fourcc) out.push_back(static_cast<std::uint8_t>(c));
  put(out, {0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71});
}

struct Mode {
  std::uint32_t width_px, height_px, period_100ns, most_bytes;
};

/// The one frame size of a format. `subtype`: of uncompressed (5) or MJPEG (7) frames
void put_frame(Bytes& out, std::uint8_t subtype, const Mode& mode) {
  const std::uint32_t bits_per_s = mode.most_bytes * 8 * (10'000'000 / mode.period_100ns);
  put(out, {30, kClassSpecific, subtype, 1, 0});
  put_number(out, mode.width_px, 2);
  put_number(out, mode.height_px, 2);
  put_number(out, bits_per_s, 4);
  put_number(out, bits_per_s, 4);
  put_number(out, mode.most_bytes, 4);
  put_number(out, mode.period_100ns, 4);
  out.push_back(1);
  put_number(out, mode.period_100ns, 4);
}

void put_uncompressed(Bytes& out, VideoFormat format, const std::string& fourcc, std::uint8_t bits) {
  put(out, {27, kClassSpecific, 4, static_cast<std::uint8_t>(format), 1});
  put_guid(out, fourcc);
  put(out, {bits, 1, 0, 0, 0, 0});
}

/// Camera terminal 1 (exposure mode and time), processing unit 2 (gain), output terminal 3.
Bytes units() {
  Bytes out{18, kClassSpecific, 2, 1, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0a, 0, 0};
  put(out, {11, kClassSpecific, 5, 2, 1, 0, 0, 2, 0x00, 0x02, 0});
  put(out, {9, kClassSpecific, 3, 3, 1, 1, 0, 2, 0});
  return out;
}

}  // namespace

Bytes UvcCamera::descriptors(const UsbPlacement& at) const {
  const auto control_interface = at.interface, stream_interface = static_cast<std::uint8_t>(at.interface + 1);
  const auto endpoint = static_cast<std::uint8_t>(0x80 | at.endpoint);
  const auto mode = [&](VideoFormat format) {
    return Mode{static_cast<std::uint32_t>(sensor_.width_px()), static_cast<std::uint32_t>(sensor_.height_px()),
                period_100ns(), frame_bytes(format)};
  };
  Bytes out{8, 0x0b, control_interface, 2, kVideo, 3, 0, 0};  // an association of both
  put(out, {9, 4, control_interface, 0, 0, kVideo, kControlInterface, 0, 0});
  const Bytes controls = units();
  put(out, {13, kClassSpecific, 1, 0, 1});
  put_number(out, static_cast<std::uint32_t>(13 + controls.size()), 2);
  put_number(out, kClock_Hz, 4);
  put(out, {1, stream_interface});
  put(out, controls);

  Bytes formats;
  put_uncompressed(formats, VideoFormat::grey, "Y800", 8);
  put_frame(formats, 5, mode(VideoFormat::grey));
  put_uncompressed(formats, VideoFormat::yuyv, "YUY2", 16);
  put_frame(formats, 5, mode(VideoFormat::yuyv));
  put(formats, {11, kClassSpecific, 6, static_cast<std::uint8_t>(VideoFormat::mjpeg), 1, 1, 1, 0, 0, 0, 0});
  put_frame(formats, 7, mode(VideoFormat::mjpeg));

  constexpr std::uint8_t kFormats = 3, kHeader = 13 + kFormats;
  put(out, {9, 4, stream_interface, 0, 1, kVideo, kStreamInterface, 0, 0});
  put(out, {kHeader, kClassSpecific, 1, kFormats});
  put_number(out, static_cast<std::uint32_t>(kHeader + formats.size()), 2);
  put(out, {endpoint, 0, 3, 0, 0, 0, 1, 0, 0, 0});
  put(out, formats);
  put(out, {7, 5, endpoint, 2, 0, 2, 0});
  return out;
}

}  // namespace celadon::sim
