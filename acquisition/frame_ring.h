#pragma once
// Byte format between the virtual scanner's frame server and its client: a SOCK_SEQPACKET Unix socket
// FOLDER/frames.sock, one struct a packet, and a memfd with the frame slots passed (SCM_RIGHTS) with the hello, so that
// frames are not copied. The memfd is sealed with F_SEAL_SHRINK. Same machine, same byte order. Version 1; later
// versions append fields and raise the number.

#include <cstdint>

namespace celadon::frame_ring {

inline constexpr std::uint32_t kMagic = 0x52464C43;  // "CLFR"
inline constexpr std::uint32_t kVersion = 1;

/// Server to client, once after connecting, with the memfd.
struct Hello {
  std::uint32_t magic = kMagic, version = kVersion;
  std::uint32_t slot_count = 0;
  std::uint32_t slot_bytes = 0;  ///< distance of slots in the memfd; slot k begins at k * slot_bytes
  std::uint32_t width_px = 0, height_px = 0, stride_bytes = 0;
  std::uint32_t format = 0;     ///< PixelFormat; YUYV is of BT.601 and full range
  std::uint32_t shutter = 0;    ///< Shutter
  std::uint32_t lock_step = 0;  ///< 1: `next` is a declared wait that advances the device's time
  std::int64_t frame_period_ns = 0, exposure_ns = 0;
  char identity[64] = {};
};

enum class RequestKind : std::uint32_t {
  start = 1,        ///< answered by Reply started
  stop = 2,         ///< answered by Reply stopped
  next = 3,         ///< value = timeout_ns; answered by frame, timed_out or fault
  give_back = 4,    ///< value = slot; not answered
  set_exposure = 5  ///< value = exposure_ns; answered by exposure (value = in force)
};

struct Request {
  RequestKind kind = RequestKind::next;
  std::uint32_t reserved = 0;
  std::int64_t value = 0;
};

enum class ReplyKind : std::uint32_t { started = 1, stopped = 2, frame = 3, timed_out = 4, exposure = 5, fault = 6 };

struct Reply {
  ReplyKind kind = ReplyKind::frame;
  std::uint32_t slot = 0;
  std::uint64_t sequence = 0;
  std::int64_t stamp_ns = 0;  ///< host clock: CLOCK_MONOTONIC in real time, device time in lock-step
  std::int64_t exposure_ns = 0;
  std::uint32_t bytes_used = 0;
  std::uint32_t corrupt = 0;
  std::int64_t value = 0;  ///< exposure in force; errno for a fault (ENODEV: unplugged)
};

}  // namespace celadon::frame_ring
