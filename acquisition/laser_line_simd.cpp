// One frame from bytes to rows, compiled once for each SIMD target and chosen at run time.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "acquisition/laser_line_simd.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include <algorithm>
#include <cstring>

#include "acquisition/laser_line_kernels.h"
#include "acquisition/laser_line_search-inl.h"
#include "acquisition/quasi_ml-inl.h"

HWY_BEFORE_NAMESPACE();
namespace celadon::line_kernels {
namespace HWY_NAMESPACE {

/// A pixel's signal as README.md defines it; colours are not limited to 0..255.
template <Signal kSignal>
HWY_INLINE int signal_at(const std::uint8_t* row, int px) {
  if constexpr (kSignal == Signal::grey) {
    return row[px];
  } else if constexpr (kSignal == Signal::yuyv_luma) {
    return row[2 * px];
  } else {
    const std::uint8_t* pair = row + 4 * (px / 2);
    const int u = pair[1] - 128, v = pair[3] - 128;
    if constexpr (kSignal == Signal::yuyv_red) return row[2 * px] + v + ((v * 206) >> 9);
    return row[2 * px] - ((u * 44 + v * 91) >> 7);
  }
}

/// From here a pixel says no more than "at least": YUYV may end at 235.
template <Signal kSignal>
constexpr int kSaturatedLevel = kSignal == Signal::grey ? 250 : 235;

/// Copies the window around the coarse peak into the batch.
template <Signal kSignal, bool kSubtract>
HWY_INLINE void add_window(Scratch& s, const std::uint8_t* on, const std::uint8_t* off, int width, int center, int row,
                           const LaserLineOptions& options) {
  const int lane = s.count;
  const int first = center - kHalf;
  const bool inside = first >= 0 && first + kWindowPx <= width;
  std::int16_t* out = s.rows[lane];
  int raw[kWindowPx];
  int highest = 0;
  const auto fill = [&](auto&& position) {
    for (int i = 0; i < kWindowPx; ++i) {
      const int px = position(i);
      raw[i] = signal_at<kSignal>(on, px);
      const int value = kSubtract ? raw[i] - signal_at<kSignal>(off, px) : raw[i];
      out[i] = static_cast<std::int16_t>(std::clamp(value, -64, 255));
      highest = std::max(highest, raw[i]);
    }
  };
  if (inside) {
    fill([first](int i) { return first + i; });
  } else {
    fill([first, width](int i) { return std::clamp(first + i, 0, width - 1); });
  }
  const bool saturated = highest >= kSaturatedLevel<kSignal>;
  s.saturated[lane] = saturated;
  if (saturated || !inside) {
    if (!s.masked) std::memset(s.usable, -1, sizeof s.usable);
    s.masked = true;
    for (int i = 0; i < kWindowPx; ++i) {
      const bool outside = first + i < 0 || first + i >= width;
      s.usable[i][lane] = outside || raw[i] >= kSaturatedLevel<kSignal> ? 0 : -1;
    }
  }
  s.left_limit[lane] = static_cast<float>(-center);
  s.right_limit[lane] = static_cast<float>(width - 1 - center);
  // Read noise, rounding, and the shot noise of the ambient light, of both frames if there are two.
  float ambient = 0;
  for (int i = 0; i < 4; ++i) ambient += static_cast<float>(raw[kHalf - 20 + i] + raw[kHalf + 16 + i]) / 8;
  const float shot = std::max(ambient, 0.f) / options.electrons_per_level;
  s.ambient_variance[lane] = (kSubtract ? 2.f : 1.f) * (options.read_noise * options.read_noise + 1.f / 12 + shot);
  s.frame_row[lane] = row;
  s.center_px[lane] = center;
  ++s.count;
}

/// Refines the batch, writes its rows and empties it.
HWY_INLINE void flush(Scratch& s, const LaserLineOptions& options, std::span<LineRow> rows) {
  if (s.count == 0) return;
  for (int lane = s.count; lane < kBatchRows; ++lane) {  // lanes without a row repeat the last one
    std::memcpy(s.rows[lane], s.rows[s.count - 1], sizeof s.rows[0]);
    s.ambient_variance[lane] = s.ambient_variance[s.count - 1];
    s.left_limit[lane] = s.left_limit[s.count - 1];
    s.right_limit[lane] = s.right_limit[s.count - 1];
  }
  for (int i = 0; i < kWindowPx; ++i) {
    for (int lane = 0; lane < kBatchRows; ++lane) s.signal[i][lane] = s.rows[lane][i];
  }
  zero_crossing(s);
  refine(s, options);
  for (int lane = 0; lane < s.count; ++lane) {
    LineRow& row = rows[static_cast<std::size_t>(s.frame_row[lane])];
    if (!(s.good[lane] > 0)) continue;
    row.x_px = static_cast<float>(s.center_px[lane]) + s.x[lane];
    row.sigma_px = s.sigma[lane];
    row.amplitude = s.amplitude[lane];
    row.width_px = s.width[lane];
    row.status = s.saturated[lane] ? RowStatus::saturated : RowStatus::found;
  }
  s.count = 0;
  s.masked = false;
}

template <Signal kSignal, bool kSubtract>
void extract_rows(const Job& job) {
  Scratch& s = *job.scratch;
  const auto stride = static_cast<std::ptrdiff_t>(job.stride_bytes);
  const int cell_count = job.width_px / 4;
  std::uint8_t* cells = s.cells + kPaddingCells;
  std::uint8_t* scores = s.scores + kPaddingCells - kPaddingCells % 64;
  s.count = 0;
  s.masked = false;
  for (int y = 0; y < job.height_px; ++y) {
    const std::uint8_t* on = job.on + stride * y;
    const std::uint8_t* off = kSubtract ? job.off + stride * y : nullptr;
    decimate<kSignal, kSubtract>(on, off, y + 2 < job.height_px ? 2 * stride : 0, cell_count, cells);
    const CoarsePeak peak = coarse_peak(cells, scores, cell_count, job.options.minimum_contrast);
    LineRow& row = job.rows[static_cast<std::size_t>(y)];
    row = {};
    if (peak.score < job.options.minimum_contrast) continue;
    if (peak.second_score * 100 > peak.score * job.options.ambiguous_percent) {
      row.status = RowStatus::ambiguous;
      continue;
    }
    add_window<kSignal, kSubtract>(s, on, off, job.width_px, peak.center_px, y, job.options);
    if (s.count == kBatchRows) flush(s, job.options, job.rows);
  }
  flush(s, job.options, job.rows);
}

template <Signal kSignal>
void extract_signal(const Job& job) {
  job.off != nullptr ? extract_rows<kSignal, true>(job) : extract_rows<kSignal, false>(job);
}

void extract_frame(const Job& job) {
  switch (job.signal) {
    case Signal::grey:
      return extract_signal<Signal::grey>(job);
    case Signal::yuyv_luma:
      return extract_signal<Signal::yuyv_luma>(job);
    case Signal::yuyv_red:
      return extract_signal<Signal::yuyv_red>(job);
    case Signal::yuyv_green:
      return extract_signal<Signal::yuyv_green>(job);
  }
}

const char* target_name() {
  return hwy::TargetName(HWY_TARGET);
}

}  // namespace HWY_NAMESPACE
}  // namespace celadon::line_kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace celadon::line_kernels {

HWY_EXPORT(extract_frame);
HWY_EXPORT(target_name);

void extract(const Job& job) {
  HWY_DYNAMIC_DISPATCH(extract_frame)(job);
}
const char* simd_target() {
  return HWY_DYNAMIC_DISPATCH(target_name)();
}

}  // namespace celadon::line_kernels
#endif
