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

/// Signal of kCutPx pixels; true if one of them is saturated.
template <Signal kSignal, bool kSubtract, class Position>
HWY_INLINE bool cut_signal(const std::uint8_t* on, const std::uint8_t* off, Position&& position, std::int16_t* raw,
                           std::int16_t* out) {
  std::int16_t highest = 0;
  for (int i = 0; i < kCutPx; ++i) {
    const int px = position(i);
    const int lit = signal_at<kSignal>(on, px);
    raw[i] = static_cast<std::int16_t>(lit);
    const int value = kSubtract ? lit - signal_at<kSignal>(off, px) : lit;
    out[i] = static_cast<std::int16_t>(std::clamp(value, -64, 255));
    highest = std::max(highest, raw[i]);
  }
  return highest >= kSaturatedLevel<kSignal>;
}

/// The same for grey pixels inside the frame, by vectors.
template <bool kSubtract>
HWY_INLINE bool cut_grey(const std::uint8_t* on, const std::uint8_t* off, std::int16_t* out) {
  const hn::CappedTag<std::uint8_t, 16> d;
  const hn::Half<decltype(d)> half;
  const hn::Rebind<std::int16_t, decltype(half)> di;
  auto highest = hn::Zero(d);
  for (int i = 0; i < kCutPx; i += 16) {
    const auto lit = hn::LoadU(d, on + i);
    highest = hn::Max(highest, lit);
    auto low = hn::PromoteTo(di, hn::LowerHalf(half, lit)), high = hn::PromoteTo(di, hn::UpperHalf(half, lit));
    if constexpr (kSubtract) {
      const auto dark = hn::LoadU(d, off + i);
      const auto floor = hn::Set(di, -64);
      low = hn::Max(floor, hn::Sub(low, hn::PromoteTo(di, hn::LowerHalf(half, dark))));
      high = hn::Max(floor, hn::Sub(high, hn::PromoteTo(di, hn::UpperHalf(half, dark))));
    }
    hn::Store(low, di, out + i);
    hn::Store(high, di, out + i + 8);
  }
  const auto saturated = hn::Set(d, static_cast<std::uint8_t>(kSaturatedLevel<Signal::grey>));
  return !hn::AllFalse(d, hn::Eq(hn::Max(highest, saturated), highest));
}

/// Mean of 8 pixels beside the line: the light that is not the laser's.
template <Signal kSignal>
HWY_INLINE float ambient_level(const std::uint8_t* row, int first, bool inside, int width) {
  int sum = 0;
  for (int i = 0; i < 4; ++i) {
    const int left = first + 16 + i, right = first + kCutPx - 20 + i;
    sum += signal_at<kSignal>(row, inside ? left : std::clamp(left, 0, width - 1));
    sum += signal_at<kSignal>(row, inside ? right : std::clamp(right, 0, width - 1));
  }
  return static_cast<float>(std::max(sum, 0)) / 8;
}

/// Cuts the pixels around the coarse peak into the batch; nothing if they hold no zero crossing.
template <Signal kSignal, bool kSubtract>
HWY_INLINE void add_row(Scratch& s, const std::uint8_t* on, const std::uint8_t* off, int width, int center, int row,
                        const LaserLineOptions& options) {
  const int lane = s.count;
  const int first = center - kCutPx / 2;
  const bool inside = first >= 0 && first + kCutPx <= width;
  const auto position = [first, width](int i) { return std::clamp(first + i, 0, width - 1); };
  std::int16_t raw[kCutPx];
  std::int16_t* cut = s.cut[lane];
  bool saturated = false;
  if constexpr (kSignal == Signal::grey) {
    saturated = inside ? cut_grey<kSubtract>(on + first, kSubtract ? off + first : nullptr, cut)
                       : cut_signal<kSignal, kSubtract>(on, off, position, raw, cut);
  } else {
    saturated = inside ? cut_signal<kSignal, kSubtract>(
                             on, off, [first](int i) { return first + i; }, raw, cut)
                       : cut_signal<kSignal, kSubtract>(on, off, position, raw, cut);
  }
  if (!zero_crossing(cut, s.x[lane])) return;
  s.saturated[lane] = saturated;
  s.row_masked[lane] = saturated || !inside;
  if (s.row_masked[lane]) {
    s.masked = true;
    for (int i = 0; i < kCutPx; ++i) {
      raw[i] = static_cast<std::int16_t>(signal_at<kSignal>(on, inside ? first + i : position(i)));
    }
    for (int i = 0; i < kCutPx; ++i) s.cut_usable[lane][i] = raw[i] >= kSaturatedLevel<kSignal> ? 0 : -1;
    for (int i = 0; i < -first; ++i) s.cut_usable[lane][i] = 0;
    for (int i = std::max(0, width - first); i < kCutPx; ++i) s.cut_usable[lane][i] = 0;
  }
  // Read noise, rounding, and the shot noise of the ambient light, of both frames if there are two.
  const float ambient = ambient_level<kSignal>(kSubtract ? off : on, first, inside, width);
  s.ambient_variance[lane] = (kSubtract ? 2.f : 1.f) * (options.read_noise * options.read_noise + 1.f / 12 +
                                                        ambient / options.electrons_per_level);
  s.frame_row[lane] = row;
  s.center_px[lane] = center;
  ++s.count;
}

/// Refines the batch, writes its rows and empties it.
HWY_INLINE void flush(Scratch& s, const LaserLineOptions& options, int width, std::span<LineRow> rows) {
  if (s.count == 0) return;
  int first[kBatchRows];
  for (int lane = 0; lane < kBatchRows; ++lane) {
    if (lane >= s.count) {  // lanes without a row repeat the last one
      std::memcpy(s.cut[lane], s.cut[s.count - 1], sizeof s.cut[0]);
      s.x[lane] = s.x[s.count - 1];
      s.ambient_variance[lane] = s.ambient_variance[s.count - 1];
      s.row_masked[lane] = false;
      first[lane] = first[s.count - 1];
      continue;
    }
    const int shift = static_cast<int>(s.x[lane] + 16.5f) - 16;  // nearest
    s.x[lane] -= static_cast<float>(shift);
    s.center_px[lane] += shift;
    first[lane] = (kCutPx - kWindowPx) / 2 + shift;
  }
  transpose_windows(s.cut, first, s.signal);
  if (s.masked) {
    for (int lane = 0; lane < kBatchRows; ++lane) {
      if (!s.row_masked[lane]) std::memset(s.cut_usable[lane], -1, sizeof s.cut_usable[0]);
    }
    transpose_windows(s.cut_usable, first, s.usable);
  }
  refine(s, options);
  for (int lane = 0; lane < s.count; ++lane) {
    const float x = static_cast<float>(s.center_px[lane]) + s.x[lane], margin = 2 * s.width[lane];
    // A line cut by the frame's border has no centre to be known.
    if (!(s.good[lane] > 0) || x < margin || x > static_cast<float>(width - 1) - margin) continue;
    LineRow& row = rows[static_cast<std::size_t>(s.frame_row[lane])];
    row.x_px = x;
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
  std::uint8_t* scores = s.scores + kPaddingCells;
  const bool narrow = cell_count < static_cast<int>(hn::Lanes(D8()));
  s.count = 0;
  s.masked = false;
  for (int y = 0; y < job.height_px; ++y) {
    const std::uint8_t* on = job.on + stride * y;
    const std::uint8_t* off = kSubtract ? job.off + stride * y : nullptr;
    const std::ptrdiff_t next = y + 2 < job.height_px ? 2 * stride : 0;
    if (narrow) {
      decimate<kSignal, kSubtract>(DNarrow(), on, off, next, cell_count, cells);
    } else {
      decimate<kSignal, kSubtract>(D8(), on, off, next, cell_count, cells);
    }
    const CoarsePeak peak = coarse_peak(cells, scores, cell_count, job.options.minimum_contrast);
    LineRow& row = job.rows[static_cast<std::size_t>(y)];
    row = {};
    if (peak.score < job.options.minimum_contrast) continue;
    if (peak.second_score * 100 > peak.score * job.options.ambiguous_percent) {
      row.status = RowStatus::ambiguous;
      continue;
    }
    add_row<kSignal, kSubtract>(s, on, off, job.width_px, peak.center_px, y, job.options);
    if (s.count == kBatchRows) flush(s, job.options, job.width_px, job.rows);
  }
  flush(s, job.options, job.width_px, job.rows);
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
