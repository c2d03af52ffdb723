#include "acquisition/laser_line.h"

#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

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
  std::vector<PeakPair> peaks = {};
  std::vector<PeakChoice> choices = {};
  std::vector<std::uint8_t> turned_on = {}, turned_off = {};  ///< a strip of columns as rows

  void search(const line_kernels::Job& frame, std::span<const LineRow> previous);
  template <class Work>
  void for_each_strip(const line_kernels::Job& frame, Work&& work);
};

/// Calls work(job) with the columns of the frame as rows, a strip at a time, and with the frame's first of them.
template <class Work>
void LaserLineExtractor::Impl::for_each_strip(const line_kernels::Job& frame, Work&& work) {
  using namespace line_kernels;
  constexpr std::size_t kLineBytes = 64;
  // An odd number of cache lines: rows of the strip that are written together fall into different sets of the cache.
  const std::size_t stride =
      ((static_cast<std::size_t>(frame.height_px) + kLineBytes - 1) / kLineBytes | 1) * kLineBytes;
  for (auto* turned : {&turned_on, &turned_off}) {
    if (turned == &turned_on || frame.off != nullptr) turned->resize(stride * kStripPx);
  }
  for (int first = 0; first < frame.width_px; first += kStripPx) {
    const int width = std::min(kStripPx, frame.width_px - first);
    Job job = frame;
    job.signal = Signal::grey;
    job.stride_bytes = stride;
    job.width_px = frame.height_px;
    job.height_px = width;
    job.rows = frame.rows.subspan(static_cast<std::size_t>(first), static_cast<std::size_t>(width));
    job.peaks = frame.peaks.subspan(static_cast<std::size_t>(first), static_cast<std::size_t>(width));
    // A strip narrower than a tile begins earlier: its first columns are turned again, and passed over.
    const int extra = std::max(0, kTilePx - width);
    const auto turned = [&](const std::uint8_t* bytes, std::vector<std::uint8_t>& into) {
      turn_strip({frame.signal, bytes, frame.stride_bytes, frame.height_px, first - extra, width + extra, into.data(),
                  stride});
      return into.data() + static_cast<std::size_t>(extra) * stride;
    };
    work(job, first, [&](Job& filled) {
      filled.on = turned(frame.on, turned_on);
      if (frame.off != nullptr) filled.off = turned(frame.off, turned_off);
    });
  }
}

void LaserLineExtractor::Impl::search(const line_kernels::Job& frame, std::span<const LineRow> previous) {
  const bool columns = options.along == LineAlong::columns;
  if (columns) {
    for_each_strip(frame, [](line_kernels::Job& strip, int, auto&& turn) {
      turn(strip);
      line_kernels::extract(strip);
    });
  } else {
    line_kernels::extract(frame);
  }
  if (!options.continuity) return;
  choose_peaks(peaks, frame.rows, previous, choices);
  if (choices.empty()) return;
  if (columns) {
    for_each_strip(frame, [&](line_kernels::Job& strip, int first, auto&& turn) {
      const auto begin = std::lower_bound(choices.begin(), choices.end(), first,
                                          [](const PeakChoice& c, int row) { return c.row < row; });
      const auto end =
          std::find_if(begin, choices.end(), [&](const PeakChoice& c) { return c.row >= first + strip.height_px; });
      if (begin == end) return;
      for (auto choice = begin; choice != end; ++choice) choice->row -= first;
      strip.chosen = {begin, end};
      turn(strip);
      line_kernels::refine_chosen(strip);
      for (auto choice = begin; choice != end; ++choice) choice->row += first;
    });
  } else {
    line_kernels::Job job = frame;
    job.chosen = choices;
    line_kernels::refine_chosen(job);
  }
}

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
                                 std::span<const std::uint8_t> off, std::span<LineRow> rows,
                                 std::span<const LineRow> previous) {
  const std::string size = std::to_string(mode.width_px) + "x" + std::to_string(mode.height_px);
  require(impl_ != nullptr, "moved from");
  const bool columns = impl_->options.along == LineAlong::columns;
  const int length_px = columns ? mode.height_px : mode.width_px, count = columns ? mode.width_px : mode.height_px;
  require(length_px >= line_kernels::kMinimumWidthPx && length_px <= line_kernels::kMaximumWidthPx,
          "frame is " + size +
              (columns ? ", height must be 64 to 4096 pixels along columns" : ", width must be 64 to 4096 pixels"));
  require(count >= (columns ? line_kernels::kTilePx : 1),
          "frame is " + size + (columns ? ", width must be at least 16 along columns" : ", height must be at least 1"));
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
  require(rows.size() == static_cast<std::size_t>(count), std::to_string(rows.size()) + " rows given for a " +
                                                              (columns ? "width" : "height") + " of " +
                                                              std::to_string(count));
  require(previous.empty() || previous.size() == rows.size(), std::to_string(previous.size()) +
                                                                  " rows of the frame before given for a frame of " +
                                                                  std::to_string(rows.size()));
  require(previous.empty() || previous.data() != rows.data(),
          "the rows of the frame before are those to be written; keep them apart");
  impl_->scratch.saturated_level = static_cast<std::int16_t>(mode.saturated_from());
  impl_->peaks.resize(rows.size());
  line_kernels::Job job;
  job.signal = signal_of(mode.format, impl_->options.channel);
  job.on = on.data();
  job.off = off.empty() ? nullptr : off.data();
  job.stride_bytes = mode.stride_bytes;
  job.width_px = mode.width_px;
  job.height_px = mode.height_px;
  job.options = impl_->options;
  job.rows = rows;
  job.peaks = impl_->peaks;
  job.scratch = &impl_->scratch;
  impl_->search(job, previous);
}

const char* laser_line_simd_target() {
  return line_kernels::simd_target();
}

}  // namespace celadon
