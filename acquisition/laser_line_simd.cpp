// One frame from bytes to rows, compiled once for each SIMD target and chosen at run time.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "acquisition/laser_line_simd.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include <algorithm>

#include "acquisition/laser_line_kernels.h"
#include "acquisition/laser_line_search-inl.h"
#include "acquisition/line_window-inl.h"
#include "acquisition/quasi_ml-inl.h"

HWY_BEFORE_NAMESPACE();
namespace celadon::line_kernels {
namespace HWY_NAMESPACE {

HWY_INLINE void write_row(const Scratch& s, int lane, int width, LineRow& row) {
  const Window& window = s.window[s.row[lane]];
  const float x = static_cast<float>(window.center_px) + s.x[lane], margin = 2 * s.width[lane];
  // A line cut by the frame's border has no centre to be known.
  if (!(s.good[lane] > 0) || x < margin || x > static_cast<float>(width - 1) - margin) return;
  row.x_px = x;
  row.sigma_px = s.sigma_x[lane];
  row.amplitude = s.amplitude[lane];
  row.width_px = s.width[lane];
  row.status = window.saturated ? RowStatus::saturated : RowStatus::found;
}

/// Lines by the time that each step takes.
HWY_INLINE PrefetchPlan plan_of(LineRefinement refinement, int row_lines) {
  const auto share = [&](int percent) { return (row_lines * percent + 99) / 100; };
  if (refinement == LineRefinement::zero_crossing) return {share(28), share(64), 0};
  return {share(17), share(40), share(110) * static_cast<int>(hn::Lanes(DF())) / kBlockRows};
}

template <Signal kSignal, bool kSubtract>
void extract_block(const Job& job, int first_row, int row_count) {
  Scratch& s = *job.scratch;
  const int cell_count = job.width_px / 4;
  const bool narrow = cell_count < static_cast<int>(hn::Lanes(D8()));
  const auto row_of = [&](const std::uint8_t* frame, int i) {
    return frame + static_cast<std::size_t>(first_row + i) * job.stride_bytes;
  };
  const int rows_ahead = std::min(kBlockRows, job.height_px - first_row - row_count);
  const int row_lines = static_cast<int>(job.stride_bytes / Prefetcher::kLineBytes) + 1;
  s.prefetch = plan_of(job.options.refinement, row_lines);
  Prefetcher ahead(row_of(job.on, row_count), kSubtract ? row_of(job.off, row_count) : nullptr, rows_ahead * row_lines);
  for (int i = 0; i < row_count; ++i) {
    ahead.advance(s.prefetch.a_row);
    const std::uint8_t* on = row_of(job.on, i);
    const std::uint8_t* off = kSubtract ? row_of(job.off, i) : nullptr;
    std::uint8_t* cells = s.cells[i] + kPaddingCells;
    if (narrow) {  // NOLINT(bugprone-branch-clone): the same where vectors have 16 lanes
      decimate<kSignal, kSubtract>(DNarrow(), on, off, cell_count, cells);
    } else {
      decimate<kSignal, kSubtract>(D8(), on, off, cell_count, cells);
    }
    pad_cells(cells, cell_count);
  }
  for (int i = 0; i < row_count; ++i) {
    ahead.advance(s.prefetch.a_row);
    score_cells(s.cells[i] + kPaddingCells, cell_count, s.scores[i] + kPaddingCells, s.best[i]);
  }
  CoarsePeak peaks[kBlockRows];
  coarse_peaks(s, row_count, cell_count, job.options, peaks);
  bool any_whole = false, any_partial = false;
  for (int i = 0; i < kBlockRows; ++i) {
    ahead.advance(s.prefetch.a_row);
    s.window[i].kind = WindowKind::none;
    if (i >= row_count) continue;
    LineRow& row = job.rows[static_cast<std::size_t>(first_row + i)];
    row = {};
    const CoarsePeak& peak = peaks[i];
    if (peak.status != RowStatus::found) {
      row.status = peak.status;
      continue;
    }
    take_row<kSignal, kSubtract>(s, i, row_of(job.on, i), kSubtract ? row_of(job.off, i) : nullptr, job.width_px,
                                 peak.center_px, job.options);
    any_whole = any_whole || s.window[i].kind == WindowKind::whole;
    any_partial = any_partial || s.window[i].kind == WindowKind::partial;
  }
  const auto refine = [&](auto&& refine_rows, WindowKind kind) {
    refine_rows(s, job.options);
    for (int lane = 0; lane < kBlockRows; ++lane) {
      if (s.kind[lane] != kind) continue;
      write_row(s, lane, job.width_px, job.rows[static_cast<std::size_t>(first_row + s.row[lane])]);
    }
  };
  if (!any_whole && !any_partial) return;
  s.ahead = ahead;
  assign_lanes(s, any_partial);
  transpose(s.cut, s.row, s.signal);
  if (any_whole) refine(refine_block<false>, WindowKind::whole);
  if (any_partial) {
    transpose(s.usable, s.row, s.usable_signal);
    refine(refine_block<true>, WindowKind::partial);
  }
}

template <Signal kSignal, bool kSubtract>
void extract_rows(const Job& job) {
  for (int row = 0; row < job.height_px; row += kBlockRows) {
    extract_block<kSignal, kSubtract>(job, row, std::min(kBlockRows, job.height_px - row));
  }
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
