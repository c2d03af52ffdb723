// A V4L2 capture device by memory-mapped streaming, or into memory of ours where a driver maps none; frames are leases
// on the driver's own buffers, or, of formats that have to be decoded, on as many grey pictures.
#include <fcntl.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <sys/mman.h>

#include <algorithm>
#include <optional>
#include <vector>

#include "acquisition/camera_fault.h"
#include "acquisition/device_holder.h"
#include "acquisition/file_descriptor.h"
#include "acquisition/frame_sources.h"
#include "acquisition/lease_book.h"
#include "acquisition/monotonic_clock.h"
#include "acquisition/picture_decoder.h"
#include "acquisition/v4l2_address.h"
#include "acquisition/v4l2_controls.h"
#include "acquisition/v4l2_exposure.h"
#include "acquisition/v4l2_ioctl.h"
#include "acquisition/v4l2_text.h"

namespace celadon {
namespace {

using Kind = CameraError::Kind;

/// Enough that a frame or two can be held back until the table's angle is known while the driver fills others.
constexpr std::uint32_t kBuffers = 8;
constexpr std::uint32_t kFewestBuffers = 2;
constexpr std::int64_t kExposureSettles_ns = 200'000'000, kExposureFrames = 4;
constexpr const char* kConnectAgain = "connect the camera and open it again";

/// Luma from 16 to 235, as the driver says or, if it does not, as V4L2 has it for YUV.
bool limited_range(const v4l2_pix_format& pixels) {
  const auto told = static_cast<v4l2_quantization>(pixels.quantization);
  return told == V4L2_QUANTIZATION_LIM_RANGE ||
         (told == V4L2_QUANTIZATION_DEFAULT && pixels.colorspace != V4L2_COLORSPACE_JPEG);
}

/// What the driver says of the colours of a format that is read in place.
ColourCoding colour_in(ColourLayout layout, std::size_t stride_bytes, const v4l2_pix_format& pixels) {
  const auto told = static_cast<v4l2_ycbcr_encoding>(pixels.ycbcr_enc);
  const bool bt709 = told == V4L2_YCBCR_ENC_709 || told == V4L2_YCBCR_ENC_XV709 ||
                     (told == V4L2_YCBCR_ENC_DEFAULT && pixels.colorspace == V4L2_COLORSPACE_REC709);
  return {layout, stride_bytes, bt709 ? LumaWeights::bt709 : LumaWeights::bt601, limited_range(pixels)};
}

/// What to do about a camera that is in use.
std::string close_other(const std::string& path) {
  const std::string holders = holders_of(path);
  return holders.empty() ? "another program uses the camera: close it" : "close what uses the camera: " + holders;
}

class V4l2Source final : public FrameSource, public FrameReturn {
 public:
  V4l2Source(const std::string& path, const std::string& device, FileDescriptor file)
      : path_(path),
        device_(device),
        file_(std::move(file)),
        exposure_(file_.get(), device),
        controls_(file_.get(), device),
        leases_(device) {}
  V4l2Source(const V4l2Source&) = delete;
  V4l2Source& operator=(const V4l2Source&) = delete;
  ~V4l2Source() override {
    stop();
    exposure_.restore();
    controls_.restore();
  }

  /// Checks what the device is and sets its format.
  tl::expected<void, CameraError> configure(const V4l2Address& address);

  const CameraMode& mode() const override { return mode_; }
  tl::expected<void, CameraError> start() override;
  void stop() noexcept override;
  tl::expected<Frame, CameraError> next(std::int64_t timeout_ns) override;

  tl::expected<std::int64_t, CameraError> set_exposure(std::int64_t exposure_ns) override {
    auto in_force = exposure_.set(exposure_ns);
    if (in_force) take_exposure(*in_force);
    return in_force;
  }
  void restore_exposure() noexcept override {
    if (exposure_.restore()) take_exposure(exposure_.in_force_ns());
  }

  void give_back(std::uint32_t index) noexcept override {
    leases_.take_back(index);
    if (decoder_ != nullptr) return;  // the driver has its buffer already
    // A device that is gone takes nothing back; the next frame says so.
    static_cast<void>(queue(index));
  }

 private:
  struct Buffer {
    void* address;
    std::size_t size;
  };

  /// Cameras take a new exposure some frames later, and no driver says with which frame.
  void take_exposure(std::int64_t in_force_ns) {
    if (in_force_ns == mode_.exposure_ns) return;
    mode_.exposure_ns = in_force_ns;
    exposure_sure_from_ns_ = monotonic_ns() + std::max(kExposureSettles_ns, kExposureFrames * mode_.frame_period_ns);
  }
  int queue(std::uint32_t index) {
    v4l2_buffer buffer{};
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = memory_;
    buffer.index = index;
    if (memory_ == V4L2_MEMORY_USERPTR) {
      buffer.m.userptr = reinterpret_cast<unsigned long>(buffers_[index].address);
      buffer.length = static_cast<std::uint32_t>(buffers_[index].size);
    }
    return v4l2_ioctl(file_.get(), VIDIOC_QBUF, &buffer);
  }
  tl::unexpected<CameraError> fault(const std::string& operation, int code, const std::string& remedy) const {
    const Kind kind = code == ENODEV                     ? Kind::unplugged
                      : code == EBUSY                    ? Kind::busy
                      : code == EACCES                   ? Kind::permission
                      : code == EINVAL || code == ENOTTY ? Kind::unsupported
                                                         : Kind::system;
    return tl::unexpected(camera_fault(kind, device_, operation, code, code == ENODEV ? kConnectAgain : remedy));
  }
  tl::unexpected<CameraError> unsupported(const std::string& operation, const std::string& cause,
                                          const std::string& remedy) const {
    return tl::unexpected(camera_fault(Kind::unsupported, device_, operation, cause, remedy));
  }
  tl::expected<std::uint32_t, CameraError> choose_format(const V4l2Address& address) const;
  tl::expected<void, CameraError> set_format(const V4l2Address& address, std::uint32_t fourcc);
  int request_buffers(v4l2_memory memory, std::uint32_t& count);
  tl::expected<void, CameraError> get_buffers();
  tl::expected<Frame, CameraError> lend(const v4l2_buffer& buffer);
  tl::expected<Frame, CameraError> lend_decoded(const v4l2_buffer& buffer, FrameInfo info);
  std::string size_text(std::uint32_t width, std::uint32_t height) const {
    return std::to_string(width) + " x " + std::to_string(height) + " px";
  }

  std::string path_, device_;
  FileDescriptor file_;
  V4l2Exposure exposure_;
  V4l2Controls controls_;
  CameraMode mode_;
  std::size_t image_bytes_ = 0;  ///< of the driver's image at most
  v4l2_memory memory_ = V4L2_MEMORY_MMAP;
  std::size_t least_bytes_ = 0;  ///< of a whole frame in the driver's buffer
  std::vector<Buffer> buffers_;
  std::unique_ptr<PictureDecoder> decoder_;  ///< nullptr: frames are used in place
  struct Decoded {
    std::vector<std::uint8_t> grey, colour;
  };
  std::vector<Decoded> decoded_;  ///< as many as buffers
  LeaseBook leases_;
  bool streaming_ = false, requested_ = false, has_sequence_ = false;
  std::uint64_t last_sequence_ = 0;
  std::int64_t exposure_sure_from_ns_ = INT64_MIN;  ///< stamps of frames that have mode_.exposure_ns
};

tl::expected<void, CameraError> V4l2Source::configure(const V4l2Address& address) {
  v4l2_capability capability{};
  if (const int code = v4l2_ioctl(file_.get(), VIDIOC_QUERYCAP, &capability); code != 0) {
    return fault("asking what it is", code, "this is no video device: give a camera's /dev/videoN");
  }
  const std::uint32_t can =
      (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? capability.device_caps : capability.capabilities;
  if ((can & V4L2_CAP_VIDEO_CAPTURE) == 0 || (can & V4L2_CAP_STREAMING) == 0) {
    return unsupported("opening", "it does not stream single-planar video (capabilities " + std::to_string(can) + ")",
                       "give the capture node of the camera, often the lower /dev/videoN of two");
  }
  const auto fourcc = choose_format(address);
  if (!fourcc) return tl::unexpected(fourcc.error());
  if (auto set = set_format(address, *fourcc); !set) return set;
  if (auto applied = controls_.apply(address.controls); !applied) return applied;

  // A rate that another program left behind would stay; drivers take the nearest they have, which is the fastest.
  v4l2_streamparm parameters{};
  parameters.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  v4l2_fract& period = parameters.parm.capture.timeperframe;
  period = {.numerator = 1, .denominator = 1000};
  const bool told = v4l2_ioctl(file_.get(), VIDIOC_S_PARM, &parameters) == 0 ||
                    v4l2_ioctl(file_.get(), VIDIOC_G_PARM, &parameters) == 0;
  if (told && period.denominator != 0) {
    mode_.frame_period_ns = std::int64_t{1'000'000'000} * period.numerator / period.denominator;
  }
  // V4L2 does not tell the shutter; cameras with an unknown one mostly roll, and the calibration has the line time.
  mode_.shutter = Shutter::rolling;
  mode_.exposure_ns = exposure_.in_force_ns();
  mode_.identity = printable(std::begin(capability.card), std::size(capability.card));
  if (const std::string serial = usb_serial_of(address.path); !serial.empty()) mode_.identity += " " + serial;
  if (mode_.identity.empty()) mode_.identity = "unnamed V4L2 camera";
  return {};
}

tl::expected<std::uint32_t, CameraError> V4l2Source::choose_format(const V4l2Address& address) const {
  std::vector<std::uint32_t> delivered;
  std::string offered;
  for (std::uint32_t i = 0; i < 256; ++i) {
    v4l2_fmtdesc format{};
    format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    format.index = i;
    const int code = v4l2_ioctl(file_.get(), VIDIOC_ENUM_FMT, &format);
    if (code == EINVAL) break;
    if (code != 0) return fault("listing its formats", code, "try another camera");
    delivered.push_back(format.pixelformat);
    offered += (offered.empty() ? "" : ", ") + fourcc_text(format.pixelformat);
  }
  const auto wanted = address.fourcc ? address.fourcc : preferred_fourcc(delivered);
  if (wanted && std::find(delivered.begin(), delivered.end(), *wanted) != delivered.end()) return *wanted;
  return unsupported("choosing a format",
                     (address.fourcc ? "it does not deliver " + fourcc_text(*address.fourcc)
                                     : std::string("it delivers no format that can be scanned with")) +
                         ", it delivers " + (offered.empty() ? "nothing" : offered),
                     "use a format that it delivers (`celadon cameras` lists them) or another camera");
}

tl::expected<void, CameraError> V4l2Source::set_format(const V4l2Address& address, std::uint32_t fourcc) {
  v4l2_format format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (const int code = v4l2_ioctl(file_.get(), VIDIOC_G_FMT, &format); code != 0) {
    return fault("reading its format", code, "try another camera");
  }
  v4l2_pix_format& pixels = format.fmt.pix;
  pixels.width = address.width.value_or(pixels.width);
  pixels.height = address.height.value_or(pixels.height);
  pixels.pixelformat = fourcc;
  pixels.field = V4L2_FIELD_NONE;
  // A stride left over from another format would be kept by some drivers.
  pixels.bytesperline = 0;
  pixels.sizeimage = 0;
  const std::string wanted = size_text(pixels.width, pixels.height) + " " + fourcc_text(fourcc);
  if (const int code = v4l2_ioctl(file_.get(), VIDIOC_S_FMT, &format); code != 0) {
    return fault("setting the format " + wanted, code,
                 code == EBUSY ? close_other(address.path) : "use a size that `celadon cameras` lists");
  }
  if (pixels.pixelformat != fourcc || (address.width && pixels.width != *address.width) ||
      (address.height && pixels.height != *address.height)) {
    return unsupported("setting the format " + wanted,
                       "the camera offers " + size_text(pixels.width, pixels.height) + " " +
                           fourcc_text(pixels.pixelformat) + " instead",
                       "use a size that `celadon cameras` lists");
  }
  if (pixels.field != V4L2_FIELD_NONE) {
    return unsupported("setting the format " + wanted, "the camera delivers interlaced fields",
                       "choose a progressive input of the camera");
  }
  const bool yuyv = fourcc == V4L2_PIX_FMT_YUYV;
  const bool packed = yuyv || fourcc == V4L2_PIX_FMT_UYVY;
  mode_.format = yuyv ? PixelFormat::yuyv : PixelFormat::grey8;
  const auto stride_bytes = std::max<std::size_t>(pixels.bytesperline, pixels.width * bytes_per_pixel(mode_.format));
  mode_.saturated_level = (packed || fourcc == V4L2_PIX_FMT_NV12) && limited_range(pixels) ? 235 : 250;
  decoder_ = PictureDecoder::of(fourcc, static_cast<int>(pixels.width), static_cast<int>(pixels.height), stride_bytes);
  mode_.stride_bytes = decoder_ ? pixels.width : stride_bytes;
  least_bytes_ = decoder_ ? decoder_->least_bytes() : stride_bytes * pixels.height;
  if (decoder_ != nullptr) {
    // A JPEG is of BT.601 and full range, whatever the driver says.
    const bool jpeg = !packed;
    mode_.colour = jpeg ? ColourCoding{decoder_->colour_layout(), pixels.width}
                        : colour_in(decoder_->colour_layout(), pixels.width, pixels);
  } else if (yuyv) {
    mode_.colour = colour_in(ColourLayout::yuyv, 0, pixels);
  } else if (fourcc == V4L2_PIX_FMT_NV12 && pixels.height % 2 == 0) {
    // The plane of chroma follows that of luma, with rows as long.
    least_bytes_ += stride_bytes * pixels.height / 2;
    mode_.colour = colour_in(ColourLayout::uv_cells, stride_bytes, pixels);
  }
  if (pixels.width < 8 || pixels.width > 65535 || pixels.height < 2 || pixels.height > 65535 ||
      least_bytes_ > pixels.sizeimage) {
    return tl::unexpected(
        camera_fault(Kind::protocol, device_, "setting the format " + wanted,
                     "the driver's image of " + std::to_string(pixels.sizeimage) + " bytes is smaller than its rows",
                     "this is a fault of the driver: use another format"));
  }
  image_bytes_ = pixels.sizeimage;
  mode_.width_px = static_cast<int>(pixels.width);
  mode_.height_px = static_cast<int>(pixels.height);
  return {};
}

int V4l2Source::request_buffers(v4l2_memory memory, std::uint32_t& count) {
  v4l2_requestbuffers request{};
  request.count = count;
  request.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  request.memory = memory;
  const int code = v4l2_ioctl(file_.get(), VIDIOC_REQBUFS, &request);
  count = request.count;
  return code;
}

tl::expected<void, CameraError> V4l2Source::get_buffers() {
  const char* operation = "getting frame buffers";
  std::uint32_t count = kBuffers;
  memory_ = V4L2_MEMORY_MMAP;
  int code = request_buffers(memory_, count);
  if (code == EINVAL) {
    memory_ = V4L2_MEMORY_USERPTR;
    count = kBuffers;
    code = request_buffers(memory_, count);
  }
  if (code != 0) {
    return fault(operation, code, code == EBUSY ? close_other(path_) : "free some memory or use a smaller size");
  }
  requested_ = true;
  if (count < kFewestBuffers) {
    return unsupported(operation, "the driver gave " + std::to_string(count) + " and streaming needs 2",
                       "free some memory or use a smaller size");
  }
  for (std::uint32_t i = 0; i < count; ++i) {
    v4l2_buffer buffer{};
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = memory_;
    buffer.index = i;
    if (code = v4l2_ioctl(file_.get(), VIDIOC_QUERYBUF, &buffer); code != 0) {
      return fault(operation, code, "try another camera");
    }
    const bool mapped = memory_ == V4L2_MEMORY_MMAP;
    const std::size_t size = mapped ? buffer.length : image_bytes_;
    if (size < least_bytes_) {
      return unsupported(operation,
                         "a buffer has " + std::to_string(size) + " bytes and a frame " + std::to_string(least_bytes_),
                         "this is a fault of the driver: use another format");
    }
    void* address = mapped
                        ? ::mmap(nullptr, size, PROT_READ, MAP_SHARED, file_.get(), static_cast<off_t>(buffer.m.offset))
                        : ::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (address == MAP_FAILED) return fault("mapping frame buffers", errno, "free some memory");
    buffers_.push_back({address, size});
    if ((buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_COPY) {
      return unsupported("streaming", "the driver does not stamp frames", "use another camera or driver");
    }
    mode_.stamp_point = (buffer.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE
                            ? StampPoint::start_of_exposure
                            : StampPoint::end_of_frame;
  }
  leases_.resize(buffers_.size());
  if (decoder_ != nullptr) {
    const std::size_t bytes = mode_.stride_bytes * static_cast<std::size_t>(mode_.height_px);
    const bool coloured = mode_.colour.layout != ColourLayout::none;
    decoded_.assign(buffers_.size(),
                    {std::vector<std::uint8_t>(bytes), std::vector<std::uint8_t>(coloured ? bytes : 0)});
  }
  return {};
}

tl::expected<void, CameraError> V4l2Source::start() {
  if (streaming_) return {};
  if (auto got = get_buffers(); !got) {
    stop();
    return got;
  }
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  int code = 0;
  for (std::uint32_t i = 0; i < buffers_.size() && code == 0; ++i) code = queue(i);
  if (code == 0) code = v4l2_ioctl(file_.get(), VIDIOC_STREAMON, &type);
  if (code != 0) {
    auto error = fault("starting the stream", code,
                       code == ENOSPC  ? "the USB bus has no room for this format: use a smaller size or another port"
                       : code == EBUSY ? close_other(path_)
                                       : "unplug the camera and connect it again");
    stop();
    return error;
  }
  streaming_ = true;
  has_sequence_ = false;
  return {};
}

void V4l2Source::stop() noexcept {
  leases_.require_none("the camera was stopped");
  // Every step is tried: a device that is gone fails them all, and the memory is unmapped all the same.
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (std::exchange(streaming_, false)) v4l2_ioctl(file_.get(), VIDIOC_STREAMOFF, &type);
  for (const Buffer& buffer : buffers_) ::munmap(buffer.address, buffer.size);
  buffers_.clear();
  if (std::exchange(requested_, false)) {
    std::uint32_t none = 0;
    request_buffers(memory_, none);
  }
}

tl::expected<Frame, CameraError> V4l2Source::next(std::int64_t timeout_ns) {
  const char* operation = "waiting for a frame";
  if (!streaming_) return unsupported(operation, "the stream is not started", "call start() before next()");
  if (leases_.count() == buffers_.size()) {
    return tl::unexpected(camera_fault(Kind::busy, device_, operation,
                                       "all " + std::to_string(buffers_.size()) + " buffers are lent",
                                       "destroy frames before asking for more", EBUSY));
  }
  const std::int64_t deadline = monotonic_ns() + std::max<std::int64_t>(timeout_ns, 0);
  for (;;) {
    v4l2_buffer buffer{};
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = memory_;
    const int code = v4l2_ioctl(file_.get(), VIDIOC_DQBUF, &buffer);
    if (code == 0) return lend(buffer);
    if (code != EAGAIN) return fault(operation, code, "stop and start the camera; if it stays so, connect it again");
    const std::int64_t left = deadline - monotonic_ns();
    if (left <= 0) {
      return tl::unexpected(camera_fault(
          Kind::timed_out, device_, operation, "no frame came within " + std::to_string(timeout_ns / 1'000'000) + " ms",
          "the stream has stalled: check the cable and the bus, then stop and start the camera", ETIMEDOUT));
    }
    // The queue's state is read again after every wait: an error or a hang-up shows in its answer, with its errno.
    const timespec wait{left / 1'000'000'000, left % 1'000'000'000};
    pollfd poll{.fd = file_.get(), .events = POLLIN, .revents = 0};
    if (::ppoll(&poll, 1, &wait, nullptr) < 0 && errno != EINTR)
      return fault(operation, errno, "open the camera again");
    if ((poll.revents & (POLLERR | POLLHUP | POLLNVAL)) != 0) {
      v4l2_buffer last{};
      last.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
      last.memory = memory_;
      const int cause = v4l2_ioctl(file_.get(), VIDIOC_DQBUF, &last);
      if (cause == 0) return lend(last);
      // A queue in error that has nothing to say would make this loop spin.
      return fault(operation, cause == EAGAIN ? EIO : cause,
                   "stop and start the camera; if it stays so, connect it again");
    }
  }
}

tl::expected<Frame, CameraError> V4l2Source::lend(const v4l2_buffer& buffer) {
  if (buffer.index >= buffers_.size() || (decoder_ == nullptr && leases_.is_lent(buffer.index))) {
    return tl::unexpected(camera_fault(Kind::protocol, device_, "waiting for a frame",
                                       "the driver named buffer " + std::to_string(buffer.index),
                                       "open the camera again"));
  }
  if ((buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) != V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC) {
    static_cast<void>(queue(buffer.index));
    return unsupported(
        "matching frames to angles",
        "the driver's time stamps are not of CLOCK_MONOTONIC (flags " + std::to_string(buffer.flags) + ")",
        "use another driver, or load uvcvideo with clock=CLOCK_MONOTONIC");
  }
  FrameInfo info;
  // The driver counts in 32 bits and starts anew with the stream.
  const std::uint32_t step = buffer.sequence - static_cast<std::uint32_t>(last_sequence_);
  info.sequence = has_sequence_ ? last_sequence_ + step : buffer.sequence;
  info.lost_before = has_sequence_ && step > 0 ? step - 1 : 0;
  info.stamp_ns = std::int64_t{buffer.timestamp.tv_sec} * 1'000'000'000 + std::int64_t{buffer.timestamp.tv_usec} * 1000;
  info.exposure_ns = mode_.exposure_ns;
  info.exposure_sure = info.stamp_ns >= exposure_sure_from_ns_;
  info.corrupt = (buffer.flags & V4L2_BUF_FLAG_ERROR) != 0 || buffer.bytesused < least_bytes_;
  last_sequence_ = info.sequence;
  has_sequence_ = true;
  if (decoder_ != nullptr) return lend_decoded(buffer, info);
  leases_.lend(buffer.index);
  const std::span bytes(static_cast<const std::uint8_t*>(buffers_[buffer.index].address), least_bytes_);
  const std::size_t own = mode_.stride_bytes * static_cast<std::size_t>(mode_.height_px);
  return Frame(this, buffer.index, bytes.first(own), info, bytes.subspan(own));
}

tl::expected<Frame, CameraError> V4l2Source::lend_decoded(const v4l2_buffer& buffer, FrameInfo info) {
  std::uint32_t slot = 0;
  while (leases_.is_lent(slot)) ++slot;  // next() saw that one is free
  Decoded& into = decoded_[slot];
  std::span<const std::uint8_t> colour;
  const Buffer& from = buffers_[buffer.index];
  const std::size_t used = std::min<std::size_t>(buffer.bytesused, from.size);
  if (!info.corrupt) {
    const auto decoded =
        decoder_->decode({static_cast<const std::uint8_t*>(from.address), used}, into.grey, into.colour);
    if (decoded && *decoded) colour = into.colour;
    info.corrupt = !decoded;
  }
  static_cast<void>(queue(buffer.index));
  leases_.lend(slot);
  return Frame(this, slot, into.grey, info, colour);
}

}  // namespace

tl::expected<std::unique_ptr<FrameSource>, CameraError> open_v4l2_source(const std::string& text) {
  const auto address = parse_v4l2_address(text);
  if (!address) return tl::unexpected(address.error());
  const std::string device = "v4l2:" + address->path;
  FileDescriptor file(::open(address->path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
  if (!file) {
    const int code = errno;
    const auto fault = [&](Kind kind, const std::string& remedy) {
      return tl::unexpected(camera_fault(kind, device, "opening", code, remedy));
    };
    switch (code) {
      case ENOENT:
        return fault(Kind::not_found, "connect the camera; `celadon cameras` lists those that are there");
      case ENODEV:
      case ENXIO:
        return fault(Kind::unplugged, kConnectAgain);
      case EACCES:
      case EPERM:
        return fault(Kind::permission, "add the user of this program to the group video and log in again");
      case EBUSY:
        return fault(Kind::busy, close_other(address->path));
      default:
        return fault(Kind::system, "check the address of the camera");
    }
  }
  auto source = std::make_unique<V4l2Source>(address->path, device, std::move(file));
  if (auto ready = source->configure(*address); !ready) return tl::unexpected(std::move(ready.error()));
  return source;
}

}  // namespace celadon
