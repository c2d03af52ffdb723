// Plays a recording. Grammar: REPLAY.md.
#include <sys/stat.h>

#include <cerrno>
#include <deque>

#include "acquisition/camera_fault.h"
#include "acquisition/frame_sources.h"
#include "acquisition/lease_book.h"
#include "acquisition/recording.h"

namespace celadon {
namespace {

using Kind = CameraError::Kind;

constexpr std::size_t kLargestIndex = std::size_t{1} << 30;

class ReplaySource final : public FrameSource, public FrameReturn {
 public:
  ReplaySource(const std::string& folder, RecordingIndex index)
      : folder_(folder), device_("replay:" + folder), index_(std::move(index)), leases_(device_) {}
  ReplaySource(const ReplaySource&) = delete;
  ReplaySource& operator=(const ReplaySource&) = delete;
  ~ReplaySource() override { stop(); }

  /// Takes the mode from the first frame.
  tl::expected<void, CameraError> prepare() {
    GreyImage first;
    const auto& frames = index_.frames;
    mode_.format = frames.front().file.ends_with(".yuyv") ? PixelFormat::yuyv : PixelFormat::grey8;
    if (auto read = read_frame(frames.front(), first); !read) return tl::unexpected(std::move(read.error()));
    mode_.width_px = first.width_px;
    mode_.height_px = first.height_px;
    mode_.stride_bytes = static_cast<std::size_t>(first.width_px) * bytes_per_pixel(mode_.format);
    mode_.shutter = index_.shutter;
    mode_.saturated_level = index_.saturated_level;
    if (mode_.format == PixelFormat::yuyv && index_.yuv) mode_.colour = *index_.yuv;
    mode_.exposure_ns = frames.front().exposure_ns;
    if (frames.size() > 1) {
      mode_.frame_period_ns =
          (frames.back().stamp_ns - frames.front().stamp_ns) / static_cast<std::int64_t>(frames.size() - 1);
    }
    mode_.identity = index_.camera;
    mode_.simulated = index_.simulated;
    return {};
  }

  const CameraMode& mode() const override { return mode_; }

  tl::expected<void, CameraError> start() override {
    next_ = 0;
    started_ = true;
    return {};
  }

  void stop() noexcept override {
    leases_.require_none("the recording was stopped");
    started_ = false;
  }

  tl::expected<Frame, CameraError> next(std::int64_t /*timeout_ns*/) override {
    if (!started_) {
      return tl::unexpected(camera_fault(Kind::unsupported, device_, "reading a frame", "the stream is not started",
                                         "call start() before next()"));
    }
    if (next_ == index_.frames.size()) {
      return tl::unexpected(camera_fault(Kind::end_of_stream, device_, "reading a frame",
                                         "the recording ended after " + std::to_string(next_) + " frames",
                                         "record more frames if these are too few"));
    }
    const RecordedFrame& recorded = index_.frames[next_];
    const std::uint32_t buffer = free_buffer();
    GreyImage& image = buffers_[buffer];
    if (auto read = read_frame(recorded, image); !read) return tl::unexpected(std::move(read.error()));
    if (image.width_px != mode_.width_px || image.height_px != mode_.height_px) {
      const auto size = [](int w, int h) { return std::to_string(w) + " x " + std::to_string(h) + " px"; };
      return tl::unexpected(
          camera_fault(Kind::protocol, device_, "reading " + recorded.file,
                       "it has " + size(image.width_px, image.height_px) + " and the first frame " +
                           size(mode_.width_px, mode_.height_px),
                       "remove line " + std::to_string(recorded.line) + " of index.csv or record again"));
    }
    FrameInfo info;
    info.sequence = next_++;
    info.stamp_ns = recorded.stamp_ns;
    info.exposure_ns = recorded.exposure_ns;
    info.has_table_angle = true;
    info.table_angle_rad = recorded.table_angle_rad;
    info.table_angle_sigma_rad = recorded.table_angle_sigma_rad;
    info.table_speed_rad_per_s = recorded.table_speed_rad_per_s;
    info.laser_on = recorded.use != FrameUse::background;
    info.laser = recorded.laser;
    info.stop = recorded.stop;
    info.use = recorded.use;
    leases_.lend(buffer);
    return Frame(this, buffer, image.bytes, info);
  }

  /// A recording cannot be exposed again: the exposure of the frame to come is in force.
  tl::expected<std::int64_t, CameraError> set_exposure(std::int64_t /*exposure_ns*/) override {
    return next_ < index_.frames.size() ? index_.frames[next_].exposure_ns : mode_.exposure_ns;
  }

  const RecordedScan* recorded() const override { return &index_.scan; }

  void give_back(std::uint32_t buffer) noexcept override { leases_.take_back(buffer); }

 private:
  /// A buffer that no frame holds; one more if all are out.
  std::uint32_t free_buffer() {
    for (std::uint32_t i = 0; i < buffers_.size(); ++i) {
      if (!leases_.is_lent(i)) return i;
    }
    buffers_.emplace_back();
    leases_.add_buffer();
    return static_cast<std::uint32_t>(buffers_.size() - 1);
  }

  tl::expected<void, CameraError> read_frame(const RecordedFrame& recorded, GreyImage& image) const {
    const std::filesystem::path file = folder_ / recorded.file;
    const auto fail = [&](const std::string& cause, int errno_value) {
      return tl::unexpected(camera_fault(errno_value == ENOENT ? Kind::not_found : Kind::protocol, device_,
                                         "reading the frame of index.csv, line " + std::to_string(recorded.line), cause,
                                         "restore the file or remove the line", errno_value));
    };
    if (mode_.format != PixelFormat::yuyv) {
      if (auto read = read_image(file, index_.colour, image); !read) {
        return fail(read.error().message, read.error().errno_value);
      }
      return {};
    }
    const std::size_t size =
        static_cast<std::size_t>(index_.yuyv_width_px) * 2 * static_cast<std::size_t>(index_.yuyv_height_px);
    auto bytes = read_bytes(file, size);
    if (!bytes) return fail(bytes.error().message, bytes.error().errno_value);
    if (bytes->size() != size) {
      return fail(recorded.file + " has " + std::to_string(bytes->size()) +
                      " bytes and a YUYV frame of this size has " + std::to_string(size),
                  0);
    }
    image = {index_.yuyv_width_px, index_.yuyv_height_px, std::move(*bytes)};
    return {};
  }

  std::filesystem::path folder_;
  std::string device_;
  RecordingIndex index_;
  CameraMode mode_;
  std::deque<GreyImage> buffers_;
  LeaseBook leases_;
  std::size_t next_ = 0;
  bool started_ = false;
};

}  // namespace

tl::expected<std::unique_ptr<FrameSource>, CameraError> open_replay_source(const std::string& folder) {
  const std::string device = "replay:" + folder;
  const std::filesystem::path file = std::filesystem::path(folder) / "index.csv";
  const auto bytes = read_bytes(file, kLargestIndex);
  if (!bytes) {
    const int code = bytes.error().errno_value;
    const Kind kind = code == ENOENT || code == ENOTDIR ? Kind::not_found
                      : code == EACCES                  ? Kind::permission
                                                        : Kind::system;
    return tl::unexpected(CameraError{
        kind, code,
        device + ": opening failed: " + file.string() + ": " +
            (code != 0 ? std::strerror(code) : "it cannot be read as a file of at most 1 GiB") +
            (code != 0 ? " (errno " + std::to_string(code) + ")" : "") + "; give the folder of a finished recording."});
  }
  auto index = parse_recording_index(std::string(bytes->begin(), bytes->end()), file.string());
  if (!index) return tl::unexpected(CameraError{Kind::protocol, 0, device + ": opening failed: " + index.error()});
  auto source = std::make_unique<ReplaySource>(folder, std::move(*index));
  if (auto ready = source->prepare(); !ready) return tl::unexpected(std::move(ready.error()));
  return source;
}

}  // namespace celadon
