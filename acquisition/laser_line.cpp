#include "acquisition/laser_line.h"

#include <stdexcept>
#include <string>
#include <utility>

#include "acquisition/laser_line_kernels.h"

namespace celadon {

namespace {

void require(bool holds, const std::string& text) {
  if (!holds) throw std::invalid_argument("LaserLineExtractor: " + text);
}

line_kernels::Signal signal_of(PixelFormat format, LineChannel channel) {
  if (format == PixelFormat::grey8) return line_kernels::Signal::grey;
  switch (channel) {
    case LineChannel::luma:
      return line_kernels::Signal::yuyv_luma;
    case LineChannel::red:
      return line_kernels::Signal::yuyv_red;
    case LineChannel::green:
      return line_kernels::Signal::yuyv_green;
  }
  throw std::invalid_argument("LaserLineExtractor: unknown channel");
}

}  // namespace

struct LaserLineExtractor::Impl {
  LaserLineOptions options;
  line_kernels::Scratch scratch;
};

LaserLineExtractor::LaserLineExtractor(const LaserLineOptions& options) {
  require(options.minimum_contrast >= 1 && options.minimum_contrast <= 255,
          "minimum_contrast is " + std::to_string(options.minimum_contrast) + ", must be 1 to 255 grey levels");
  require(options.ambiguous_percent >= 1 && options.ambiguous_percent <= 100,
          "ambiguous_percent is " + std::to_string(options.ambiguous_percent) + ", must be 1 to 100");
  require(options.read_noise >= 0 && options.electrons_per_level > 0 && options.speckle_contrast >= 0 &&
              options.speckle_extent_px > 0,
          "noise figures must not be negative, and electrons_per_level and speckle_extent_px must be positive");
  impl_ = new Impl{options, {}};
}

LaserLineExtractor::~LaserLineExtractor() {
  delete impl_;
}
LaserLineExtractor::LaserLineExtractor(LaserLineExtractor&& other) noexcept
    : impl_(std::exchange(other.impl_, nullptr)) {}
LaserLineExtractor& LaserLineExtractor::operator=(LaserLineExtractor&& other) noexcept {
  std::swap(impl_, other.impl_);
  return *this;
}

void LaserLineExtractor::extract(const CameraMode& mode, std::span<const std::uint8_t> on,
                                 std::span<const std::uint8_t> off, std::span<LineRow> rows) {
  const std::string size = std::to_string(mode.width_px) + "x" + std::to_string(mode.height_px);
  require(impl_ != nullptr, "moved from");
  require(mode.width_px >= line_kernels::kMinimumWidthPx && mode.width_px <= line_kernels::kMaximumWidthPx,
          "frame is " + size + ", width must be 64 to 4096 pixels");
  require(mode.height_px >= 1, "frame is " + size + ", height must be at least 1");
  require(mode.format == PixelFormat::grey8 || mode.format == PixelFormat::yuyv, "unknown pixel format");
  require(mode.format != PixelFormat::yuyv || mode.width_px % 2 == 0,
          "frame is " + size + ", YUYV needs an even width");
  require(mode.saturated_level >= 0 && mode.saturated_level <= 255,
          "saturated_level is " + std::to_string(mode.saturated_level) + ", must be 0 to 255");
  const std::size_t row_bytes = static_cast<std::size_t>(mode.width_px) * bytes_per_pixel(mode.format);
  require(mode.stride_bytes >= row_bytes, "stride is " + std::to_string(mode.stride_bytes) + " bytes, a row of " +
                                              size + " needs " + std::to_string(row_bytes));
  const std::size_t frame_bytes = mode.stride_bytes * static_cast<std::size_t>(mode.height_px - 1) + row_bytes;
  require(on.size() >= frame_bytes,
          "frame holds " + std::to_string(on.size()) + " bytes, " + size + " needs " + std::to_string(frame_bytes));
  require(off.empty() || off.size() >= frame_bytes, "laser-off frame holds " + std::to_string(off.size()) + " bytes, " +
                                                        size + " needs " + std::to_string(frame_bytes));
  require(rows.size() == static_cast<std::size_t>(mode.height_px),
          std::to_string(rows.size()) + " rows given for a height of " + std::to_string(mode.height_px));
  const int usual_level = mode.format == PixelFormat::grey8 ? 250 : 235;
  impl_->scratch.saturated_level =
      static_cast<std::int16_t>(mode.saturated_level > 0 ? mode.saturated_level : usual_level);
  line_kernels::extract({signal_of(mode.format, impl_->options.channel), on.data(), off.empty() ? nullptr : off.data(),
                         mode.stride_bytes, mode.width_px, mode.height_px, impl_->options, rows, &impl_->scratch});
}

const char* laser_line_simd_target() {
  return line_kernels::simd_target();
}

}  // namespace celadon
