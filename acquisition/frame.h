#pragma once
// Frames as move-only leases on the driver's buffer, and the sources they come from.

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/axis_stop.h"
#include "acquisition/colour_coding.h"

namespace celadon {

enum class PixelFormat : std::uint32_t { grey8 = 1, yuyv = 2 };
const char* to_string(PixelFormat format);
inline std::size_t bytes_per_pixel(PixelFormat format) {
  return format == PixelFormat::grey8 ? 1 : 2;
}

enum class Shutter : std::uint32_t { global = 0, rolling = 1 };

/// The event that a driver's stamp belongs to. The time model of a calibration holds for the one it was made with.
enum class StampPoint : std::uint32_t { end_of_frame = 0, start_of_exposure = 1 };

/// What the camera delivers and cannot change during a stream.
struct CameraMode {
  int width_px = 0, height_px = 0;
  std::size_t stride_bytes = 0;
  PixelFormat format = PixelFormat::grey8;
  int saturated_level = 0;  ///< from here a sample says no more than "at least"; 0: 250 of grey8, 235 of yuyv
  Shutter shutter = Shutter::global;
  std::int64_t frame_period_ns = 0;
  std::int64_t exposure_ns = 0;
  std::string identity;  ///< name and serial number, as calibration files quote it
  bool simulated = false;
  StampPoint stamp_point = StampPoint::end_of_frame;  ///< of a V4L2 device known once it streams
  ColourCoding colour = {};
  bool operator==(const CameraMode&) const = default;

  /// saturated_level, or what it stands for where it is 0.
  int saturated_from() const {
    return saturated_level > 0 ? saturated_level : format == PixelFormat::grey8 ? 250 : 235;
  }
};

/// What a recorded frame was for.
enum class FrameUse : std::uint8_t {
  background,  ///< laser off
  look,        ///< the object before the table turned
  turn,
  overlap  ///< beyond the full turn
};

/// What is known of one frame.
struct FrameInfo {
  std::uint64_t sequence = 0;     ///< of the driver; a gap means lost frames
  std::int64_t stamp_ns = 0;      ///< of the driver, host clock; the time model of the calibration says what it means
  std::int64_t exposure_ns = 0;   ///< in force for this frame
  bool exposure_sure = true;      ///< false: the exposure was changed just before, and the driver does not say which of
                                  ///< the two this frame has
  std::uint32_t lost_before = 0;  ///< frames lost between the previous one and this one
  bool corrupt = false;           ///< the driver flagged an error in the buffer
  // Of a recording only, noted with the frame:
  bool has_table_angle = false;
  double table_angle_rad = 0, table_angle_sigma_rad = 0, table_speed_rad_per_s = 0;
  bool laser_on = true;
  int laser = 0;  ///< whose turn the frame belongs to, its background and looks too
  AxisStop stop;  ///< of that turn
  FrameUse use = FrameUse::turn;
};

/// The scan whose frames a recording holds; empty and 0 where the recording does not say.
struct RecordedScan {
  std::string date;              ///< ISO 8601 UTC
  std::string mode;              ///< "step", "sweep"
  int profiles = 0;              ///< a turn
  std::vector<int> lasers = {};  ///< in the order of their turns; empty: one, and the recording does not say which
  std::vector<AxisStop> stops =
      {};  ///< where the axes stood, in the order of the turns; at each, a turn with each laser
};

/// A device or system fault of a camera: one sentence with operation, device, cause, errno and the remedy.
struct CameraError {
  enum class Kind { not_found, permission, busy, unplugged, timed_out, unsupported, protocol, system, end_of_stream };
  Kind kind = Kind::system;
  int errno_value = 0;
  std::string message;
};

/// Takes a buffer back. Implemented by sources.
class FrameReturn {
 public:
  virtual ~FrameReturn() = default;
  virtual void give_back(std::uint32_t buffer) noexcept = 0;
};

/// A lease on one buffer of the driver: move-only, destroying it requeues the buffer. Must not outlive its source.
class Frame {
 public:
  Frame() = default;
  Frame(FrameReturn* owner, std::uint32_t buffer, std::span<const std::uint8_t> bytes, const FrameInfo& frame_info,
        std::span<const std::uint8_t> colour = {})
      : info(frame_info), owner_(owner), buffer_(buffer), bytes_(bytes), colour_(colour) {}
  Frame(Frame&& other) noexcept
      : info(other.info),
        owner_(std::exchange(other.owner_, nullptr)),
        buffer_(other.buffer_),
        bytes_(std::exchange(other.bytes_, {})),
        colour_(std::exchange(other.colour_, {})) {}
  Frame& operator=(Frame&& other) noexcept {
    if (this != &other) {
      release();
      info = other.info;
      owner_ = std::exchange(other.owner_, nullptr);
      buffer_ = other.buffer_;
      bytes_ = std::exchange(other.bytes_, {});
      colour_ = std::exchange(other.colour_, {});
    }
    return *this;
  }
  Frame(const Frame&) = delete;
  Frame& operator=(const Frame&) = delete;
  ~Frame() { release(); }

  std::span<const std::uint8_t> bytes() const { return bytes_; }
  /// What CameraMode::colour says lies beside bytes(); empty where this picture has no colours.
  std::span<const std::uint8_t> colour() const { return colour_; }
  explicit operator bool() const { return owner_ != nullptr; }
  void release() noexcept {
    if (owner_ != nullptr) std::exchange(owner_, nullptr)->give_back(buffer_);
    bytes_ = colour_ = {};
  }

  FrameInfo info;

 private:
  FrameReturn* owner_ = nullptr;
  std::uint32_t buffer_ = 0;
  std::span<const std::uint8_t> bytes_, colour_;
};

/// Where frames come from: V4L2 device, virtual scanner, recorded folder. Used from one thread.
class FrameSource {
 public:
  virtual ~FrameSource() = default;
  virtual const CameraMode& mode() const = 0;
  virtual tl::expected<void, CameraError> start() = 0;
  /// Stops the stream and releases the device's buffers; every lease must be gone. Also done by the destructor.
  virtual void stop() noexcept = 0;
  /// The oldest frame not yet taken, waiting at most timeout_ns of the host clock; Kind::timed_out after that (the
  /// dequeue watchdog), Kind::end_of_stream after the last recorded one.
  virtual tl::expected<Frame, CameraError> next(std::int64_t timeout_ns) = 0;
  /// Whether the camera is still connected, which the driver knows without a frame. What cannot be unplugged is.
  virtual tl::expected<void, CameraError> check_present() const { return {}; }
  /// Exposure time for the frames to come; the value in force is returned.
  virtual tl::expected<std::int64_t, CameraError> set_exposure(std::int64_t exposure_ns) = 0;
  /// Puts back the exposure, or the automatic, that was found before the first set_exposure(); nothing if there was
  /// none. Also done by the destructor of a camera.
  virtual void restore_exposure() noexcept {}
  /// Of a recording: its frames know their angles, and there is no machine; nullptr for a camera.
  virtual const RecordedScan* recorded() const { return nullptr; }
};

/// Opens "v4l2:/dev/video0[?width=..&height=..&format=GREY|YUYV]", "v4l2:serial=CAM001[?..]" (on USB), "sim:FOLDER" (of
/// celadon-sim --socket-dir) or "replay:FOLDER".
tl::expected<std::unique_ptr<FrameSource>, CameraError> open_frame_source(const std::string& url);

}  // namespace celadon
