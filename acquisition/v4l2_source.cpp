// A V4L2 capture device: frames are leases on the driver's own buffers, or, of formats that have to be decoded, on as
// many grey pictures.
#include <fcntl.h>

#include <algorithm>
#include <optional>
#include <vector>

#include "acquisition/camera_fault.h"
#include "acquisition/file_descriptor.h"
#include "acquisition/frame_sources.h"
#include "acquisition/lease_book.h"
#include "acquisition/monotonic_clock.h"
#include "acquisition/picture_decoder.h"
#include "acquisition/v4l2_address.h"
#include "acquisition/v4l2_capture.h"
#include "acquisition/v4l2_controls.h"
#include "acquisition/v4l2_devices.h"
#include "acquisition/v4l2_exposure.h"
#include "acquisition/v4l2_fault.h"
#include "acquisition/v4l2_ioctl.h"
#include "acquisition/v4l2_queue.h"
#include "acquisition/v4l2_text.h"

namespace celadon {
namespace {

using Kind = CameraError::Kind;

constexpr std::int64_t kExposureSettles_ns = 200'000'000, kExposureFrames = 4;

/// Luma from 16 to 235, as the driver says or, if it does not, as V4L2 has it for YUV.
bool limited_range(const V4l2Picture& picture) {
  const auto told = static_cast<v4l2_quantization>(picture.quantization);
  return told == V4L2_QUANTIZATION_LIM_RANGE ||
         (told == V4L2_QUANTIZATION_DEFAULT && picture.colorspace != V4L2_COLORSPACE_JPEG);
}

/// What the driver says of the colours of a format that is read in place.
ColourCoding colour_in(ColourLayout layout, std::size_t stride_bytes, const V4l2Picture& picture) {
  const auto told = static_cast<v4l2_ycbcr_encoding>(picture.ycbcr_encoding);
  const bool bt709 = told == V4L2_YCBCR_ENC_709 || told == V4L2_YCBCR_ENC_XV709 ||
                     (told == V4L2_YCBCR_ENC_DEFAULT && picture.colorspace == V4L2_COLORSPACE_REC709);
  return {layout, stride_bytes, bt709 ? LumaWeights::bt709 : LumaWeights::bt601, limited_range(picture)};
}

/// Formats with a luma, be it packed or a plane of the picture.
bool has_luma(std::uint32_t fourcc) {
  constexpr std::uint32_t kLuma[] = {V4L2_PIX_FMT_YUYV,  V4L2_PIX_FMT_UYVY,    V4L2_PIX_FMT_NV12,
                                     V4L2_PIX_FMT_NV12M, V4L2_PIX_FMT_YUV420M, V4L2_PIX_FMT_NV16M};
  return std::find(std::begin(kLuma), std::end(kLuma), fourcc) != std::end(kLuma);
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
  tl::expected<void, CameraError> check_present() const override {
    v4l2_capability capability{};
    const int code = v4l2_ioctl(file_.get(), VIDIOC_QUERYCAP, &capability);
    if (code != 0) return fault("looking for it", code, kConnectCameraAgain);
    return {};
  }

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
    static_cast<void>(queue_->give(index));
  }

 private:
  /// Cameras take a new exposure some frames later, and no driver says with which frame.
  void take_exposure(std::int64_t in_force_ns) {
    if (in_force_ns == mode_.exposure_ns) return;
    mode_.exposure_ns = in_force_ns;
    exposure_sure_from_ns_ = monotonic_ns() + std::max(kExposureSettles_ns, kExposureFrames * mode_.frame_period_ns);
  }
  tl::unexpected<CameraError> fault(const std::string& operation, int code, const std::string& remedy) const {
    return tl::unexpected(v4l2_fault(device_, operation, code, remedy));
  }
  tl::unexpected<CameraError> unsupported(const std::string& operation, const std::string& cause,
                                          const std::string& remedy) const {
    return tl::unexpected(camera_fault(Kind::unsupported, device_, operation, cause, remedy));
  }
  tl::expected<std::uint32_t, CameraError> choose_format(const V4l2Address& address) const;
  tl::expected<void, CameraError> set_format(const V4l2Address& address, std::uint32_t fourcc);
  tl::expected<Frame, CameraError> lend(const FilledBuffer& buffer);
  tl::expected<Frame, CameraError> lend_decoded(const FilledBuffer& buffer, FrameInfo info);
  std::string size_text(std::uint32_t width, std::uint32_t height) const {
    return std::to_string(width) + " x " + std::to_string(height) + " px";
  }

  std::string path_, device_;
  FileDescriptor file_;
  V4l2Exposure exposure_;
  V4l2Controls controls_;
  CameraMode mode_;
  v4l2_buf_type type_ = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  std::vector<std::uint32_t> plane_bytes_;   ///< of the driver's picture at most
  std::size_t least_bytes_ = 0;              ///< of a whole frame in the first plane of the driver's buffer
  std::unique_ptr<V4l2Queue> queue_;         ///< while it streams
  std::unique_ptr<PictureDecoder> decoder_;  ///< nullptr: frames are used in place
  struct Decoded {
    std::vector<std::uint8_t> grey, colour;
  };
  std::vector<Decoded> decoded_;  ///< as many as buffers
  LeaseBook leases_;
  bool has_sequence_ = false;
  std::uint64_t last_sequence_ = 0;
  std::int64_t exposure_sure_from_ns_ = INT64_MIN;  ///< stamps of frames that have mode_.exposure_ns
};

tl::expected<void, CameraError> V4l2Source::configure(const V4l2Address& address) {
  v4l2_capability capability{};
  if (const int code = v4l2_ioctl(file_.get(), VIDIOC_QUERYCAP, &capability); code != 0) {
    return fault("asking what it is", code, "this is no video device: give a camera's /dev/videoN");
  }
  const auto type = capture_type_of(capability);
  if (!type || !can_stream(capability)) {
    return unsupported("opening", type ? "it does not stream" : "it captures no video",
                       "give the capture node of the camera, often the lower /dev/videoN of two");
  }
  type_ = *type;
  const auto fourcc = choose_format(address);
  if (!fourcc) return tl::unexpected(fourcc.error());
  if (auto set = set_format(address, *fourcc); !set) return set;
  if (auto applied = controls_.apply(address.controls); !applied) return applied;

  // A rate that another program left behind would stay; drivers take the nearest they have, which is the fastest.
  v4l2_streamparm parameters{};
  parameters.type = type_;
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
    format.type = type_;
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
  V4l2Picture picture;
  if (const int code = read_picture(file_.get(), type_, picture); code != 0) {
    return fault("reading its format", code, "try another camera");
  }
  picture.width_px = address.width.value_or(picture.width_px);
  picture.height_px = address.height.value_or(picture.height_px);
  picture.fourcc = fourcc;
  const std::string operation =
      "setting the format " + size_text(picture.width_px, picture.height_px) + " " + fourcc_text(fourcc);
  if (const int code = set_picture(file_.get(), type_, picture); code != 0) {
    return fault(operation, code,
                 code == EBUSY ? close_other_user_of(path_) : "use a size that `celadon cameras` lists");
  }
  if (picture.fourcc != fourcc || (address.width && picture.width_px != *address.width) ||
      (address.height && picture.height_px != *address.height)) {
    return unsupported(operation,
                       "the camera offers " + size_text(picture.width_px, picture.height_px) + " " +
                           fourcc_text(picture.fourcc) + " instead",
                       "use a size that `celadon cameras` lists");
  }
  if (picture.field != V4L2_FIELD_NONE) {
    return unsupported(operation, "the camera delivers interlaced fields", "choose a progressive input of the camera");
  }
  const std::size_t width = picture.width_px, height = picture.height_px;
  // The first plane has all that is read: the whole picture, or the luma of those in several.
  const V4l2Picture::Plane plane = picture.planes.empty() ? V4l2Picture::Plane{} : picture.planes.front();
  mode_.format = fourcc == V4L2_PIX_FMT_YUYV ? PixelFormat::yuyv : PixelFormat::grey8;
  const auto stride_bytes = std::max<std::size_t>(plane.stride_bytes, width * bytes_per_pixel(mode_.format));
  mode_.saturated_level = has_luma(fourcc) && limited_range(picture) ? 235 : 250;
  mode_.width_px = static_cast<int>(width);
  mode_.height_px = static_cast<int>(height);
  decoder_ = PictureDecoder::of(fourcc, mode_.width_px, mode_.height_px, stride_bytes);
  mode_.stride_bytes = decoder_ ? width : stride_bytes;
  least_bytes_ = decoder_ ? decoder_->least_bytes() : stride_bytes * height;
  if (decoder_ != nullptr) {
    // A JPEG is of BT.601 and full range, whatever the driver says.
    const bool jpeg = fourcc != V4L2_PIX_FMT_UYVY;
    mode_.colour =
        jpeg ? ColourCoding{decoder_->colour_layout(), width} : colour_in(decoder_->colour_layout(), width, picture);
  } else if (fourcc == V4L2_PIX_FMT_YUYV) {
    mode_.colour = colour_in(ColourLayout::yuyv, 0, picture);
  } else if (fourcc == V4L2_PIX_FMT_NV12 && height % 2 == 0) {
    // The plane of chroma follows that of luma, with rows as long.
    least_bytes_ += stride_bytes * height / 2;
    mode_.colour = colour_in(ColourLayout::uv_cells, stride_bytes, picture);
  }
  if (width < 8 || width > 65535 || height < 2 || height > 65535 || least_bytes_ > plane.bytes) {
    return tl::unexpected(
        camera_fault(Kind::protocol, device_, operation,
                     "the driver's image of " + std::to_string(plane.bytes) + " bytes is smaller than its rows",
                     "this is a fault of the driver: use another format"));
  }
  plane_bytes_.clear();
  for (const V4l2Picture::Plane& each : picture.planes) plane_bytes_.push_back(each.bytes);
  return {};
}

tl::expected<void, CameraError> V4l2Source::start() {
  if (queue_) return {};
  auto queue = V4l2Queue::open({file_.get(), type_, path_, device_}, plane_bytes_, least_bytes_);
  if (!queue) return tl::unexpected(std::move(queue.error()));
  if (((*queue)->flags() & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_COPY) {
    return unsupported("streaming", "the driver does not stamp frames", "use another camera or driver");
  }
  mode_.stamp_point = ((*queue)->flags() & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE
                          ? StampPoint::start_of_exposure
                          : StampPoint::end_of_frame;
  leases_.resize((*queue)->size());
  if (decoder_ != nullptr) {
    const std::size_t bytes = mode_.stride_bytes * static_cast<std::size_t>(mode_.height_px);
    const bool coloured = mode_.colour.layout != ColourLayout::none;
    decoded_.assign((*queue)->size(),
                    {std::vector<std::uint8_t>(bytes), std::vector<std::uint8_t>(coloured ? bytes : 0)});
  }
  if (auto started = (*queue)->start(); !started) return started;
  queue_ = std::move(*queue);
  has_sequence_ = false;
  return {};
}

void V4l2Source::stop() noexcept {
  leases_.require_none("the camera was stopped");
  queue_.reset();
}

tl::expected<Frame, CameraError> V4l2Source::next(std::int64_t timeout_ns) {
  const char* operation = "waiting for a frame";
  if (!queue_) return unsupported(operation, "the stream is not started", "call start() before next()");
  if (leases_.count() == queue_->size()) {
    return tl::unexpected(camera_fault(Kind::busy, device_, operation,
                                       "all " + std::to_string(queue_->size()) + " buffers are lent",
                                       "destroy frames before asking for more", EBUSY));
  }
  const auto buffer = queue_->next(timeout_ns);
  if (!buffer) return tl::unexpected(buffer.error());
  return lend(*buffer);
}

tl::expected<Frame, CameraError> V4l2Source::lend(const FilledBuffer& buffer) {
  if (decoder_ == nullptr && leases_.is_lent(buffer.index)) {
    return tl::unexpected(camera_fault(Kind::protocol, device_, "waiting for a frame",
                                       "the driver named buffer " + std::to_string(buffer.index) + ", which is lent",
                                       "open the camera again"));
  }
  if ((buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) != V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC) {
    static_cast<void>(queue_->give(buffer.index));
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
  info.stamp_ns = buffer.stamp_ns;
  info.exposure_ns = mode_.exposure_ns;
  info.exposure_sure = info.stamp_ns >= exposure_sure_from_ns_;
  info.corrupt = (buffer.flags & V4L2_BUF_FLAG_ERROR) != 0 || buffer.used_bytes < least_bytes_;
  last_sequence_ = info.sequence;
  has_sequence_ = true;
  if (decoder_ != nullptr) return lend_decoded(buffer, info);
  leases_.lend(buffer.index);
  const std::span<const std::uint8_t> bytes = buffer.memory.first(least_bytes_);
  const std::size_t own = mode_.stride_bytes * static_cast<std::size_t>(mode_.height_px);
  return Frame(this, buffer.index, bytes.first(own), info, bytes.subspan(own));
}

tl::expected<Frame, CameraError> V4l2Source::lend_decoded(const FilledBuffer& buffer, FrameInfo info) {
  std::uint32_t slot = 0;
  while (leases_.is_lent(slot)) ++slot;  // next() saw that one is free
  Decoded& into = decoded_[slot];
  std::span<const std::uint8_t> colour;
  if (!info.corrupt) {
    const auto decoded = decoder_->decode(buffer.memory.first(buffer.used_bytes), into.grey, into.colour);
    if (decoded && *decoded) colour = into.colour;
    info.corrupt = !decoded;
  }
  static_cast<void>(queue_->give(buffer.index));
  leases_.lend(slot);
  return Frame(this, slot, into.grey, info, colour);
}

}  // namespace

tl::expected<std::unique_ptr<FrameSource>, CameraError> open_v4l2_source(const std::string& text) {
  auto address = parse_v4l2_address(text);
  if (!address) return tl::unexpected(address.error());
  const std::string device = "v4l2:" + text.substr(0, text.find('?'));
  if (!address->serial.empty()) {
    auto found = find_v4l2_device(address->serial);
    if (!found) return tl::unexpected(std::move(found.error()));
    address->path = std::move(*found);
  }
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
        return fault(Kind::unplugged, kConnectCameraAgain);
      case EACCES:
      case EPERM:
        return fault(Kind::permission, "add the user of this program to the group video and log in again");
      case EBUSY:
        return fault(Kind::busy, close_other_user_of(address->path));
      default:
        return fault(Kind::system, "check the address of the camera");
    }
  }
  auto source = std::make_unique<V4l2Source>(address->path, device, std::move(file));
  if (auto ready = source->configure(*address); !ready) return tl::unexpected(std::move(ready.error()));
  return source;
}

}  // namespace celadon
