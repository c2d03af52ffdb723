// One frame from bytes to rows, compiled once for each SIMD target and chosen at run time.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "acquisition/laser_line_simd.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include <algorithm>

#include "acquisition/laser_line_kernels.h"
#include "acquisition/laser_line_search-inl.h"
#include "acquisition/line_strip-inl.h"
#include "acquisition/line_window-inl.h"
#include "acquisition/quasi_ml-inl.h"
#include "hwy/cache_control.h"

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

/// Asks for rows some time before they are worked on, a cache line with each iteration of the loops over the rows in
/// work: a core waits for few lines of memory at once, and those asked for in a burst wait for each other.
/// Inlined always: g++ takes a function that only asks for memory for one without effects, and leaves out its calls.
class RowRequest {
 public:
  /// The row that is asked for when `row` is in work. Processors drop a request in a page whose address they do not
  /// know: has those of a later row looked up.
  HWY_INLINE RowRequest(const std::uint8_t* frame, std::size_t stride_bytes, std::size_t row_bytes, int row,
                        int row_count)
      : next_(frame + static_cast<std::size_t>(std::min(row + kRowsAsked, row_count - 1)) * stride_bytes),
        end_(next_ + row_bytes) {
    const auto later = static_cast<std::size_t>(std::min(row + kRowsOfPages, row_count - 1)) * stride_bytes;
    for (std::size_t i = 0; i < row_bytes; i += kPageBytes) hwy::Prefetch(frame + later + i);
  }

  HWY_INLINE void ask() {
    constexpr int kSecondLevel = 2;  // of the cache: the first is full of rows in work
    if (next_ >= end_) return;
    __builtin_prefetch(next_, 0, kSecondLevel);
    next_ += kLineBytes;
  }

 private:
  static constexpr std::size_t kLineBytes = 64, kPageBytes = 4096;
  static constexpr int kRowsAsked = 14, kRowsOfPages = 15;
  const std::uint8_t* next_;
  const std::uint8_t* end_;
};

/// Positions of the windows that were cut, written to their rows; those without a window are left.
HWY_INLINE void refine_windows(const Job& job) {
  Scratch& s = *job.scratch;
  bool any_whole = false, any_partial = false;
  for (const Window& window : s.window) {
    any_whole = any_whole || window.kind == WindowKind::whole;
    any_partial = any_partial || window.kind == WindowKind::partial;
  }
  const auto refine = [&](auto&& refine_rows, WindowKind kind) {
    refine_rows(s, job.options);
    for (int lane = 0; lane < kBlockRows; ++lane) {
      if (s.kind[lane] != kind) continue;
      write_row(s, lane, job.width_px, job.rows[static_cast<std::size_t>(s.frame_row[s.row[lane]])]);
    }
  };
  if (!any_whole && !any_partial) return;
  assign_lanes(s, any_partial);
  transpose(s.cut, s.row, s.signal);
  if (any_whole) refine(refine_block<false>, WindowKind::whole);
  if (any_partial) {
    transpose(s.usable, s.row, s.usable_signal);
    refine(refine_block<true>, WindowKind::partial);
  }
}

template <Signal kSignal, bool kSubtract>
void extract_block(const Job& job, int first_row, int row_count) {
  Scratch& s = *job.scratch;
  const int cell_count = job.width_px / 4;
  const bool narrow = cell_count < static_cast<int>(hn::Lanes(D8()));
  const auto row_of = [&](const std::uint8_t* frame, int i) {
    return frame + static_cast<std::size_t>(first_row + i) * job.stride_bytes;
  };
  const std::size_t row_bytes = static_cast<std::size_t>(job.width_px) * (kSignal == Signal::grey ? 1 : 2);
  const auto request = [&](const std::uint8_t* frame, int row)
                           HWY_ATTR { return RowRequest(frame, job.stride_bytes, row_bytes, row, job.height_px); };
  TopScore top[kRowsInWork];
  CoarsePeak peaks[kBlockRows];
  for (int i = row_count; i < kBlockRows; ++i) s.window[i].kind = WindowKind::none;
  // A row's five steps in five turns: its stores are in the cache when it is read again.
  for (int turn = 0; turn < row_count + kRowsInWork - 1; ++turn) {
    RowRequest on_request = request(job.on, first_row + turn);
    RowRequest off_request = kSubtract ? request(job.off, first_row + turn) : on_request;
    const auto ask = [&]() HWY_ATTR {
      for (int k = 0; k < (kSignal == Signal::grey ? 1 : 2); ++k) {
        on_request.ask();
        if (kSubtract) off_request.ask();
      }
    };
    const auto in_turn = [&](int step, auto&& work) {
      const int i = turn - step;
      if (i >= 0 && i < row_count) work(i, i % kRowsInWork);
    };
    in_turn(0, [&](int i, int slot) {
      const std::uint8_t* on = row_of(job.on, i);
      const std::uint8_t* off = kSubtract ? row_of(job.off, i) : nullptr;
      std::uint8_t* cells = s.cells[slot] + kPaddingCells;
      if (narrow) {  // NOLINT(bugprone-branch-clone): the same where vectors have 16 lanes
        decimate<kSignal, kSubtract>(DNarrow(), on, off, cell_count, cells, ask);
      } else {
        decimate<kSignal, kSubtract>(D8(), on, off, cell_count, cells, ask);
      }
      pad_cells(cells, cell_count);
    });
    in_turn(1, [&](int, int slot) {
      const auto highest = score_cells(s.cells[slot] + kPaddingCells, cell_count, s.scores[slot] + kPaddingCells, ask);
      hn::Store(highest, D8(), s.highest[slot]);
    });
    in_turn(2, [&](int, int slot) {
      top[slot] = take_top(s.scores[slot] + kPaddingCells, cell_count, hn::Load(D8(), s.highest[slot]));
    });
    in_turn(3, [&](int i, int slot) {
      peaks[i] = judge(top[slot], s.scores[slot] + kPaddingCells, cell_count, job.options, ask);
    });
    in_turn(4, [&](int i, int) {
      const bool found = peaks[i].status == RowStatus::found, none = peaks[i].status == RowStatus::no_line;
      s.frame_row[i] = first_row + i;
      LineRow& row = job.rows[static_cast<std::size_t>(first_row + i)];
      row = {};
      row.status = found ? RowStatus::no_line : peaks[i].status;
      job.peaks[static_cast<std::size_t>(first_row + i)] = {static_cast<std::int16_t>(none ? -1 : peaks[i].center_px),
                                                            static_cast<std::int16_t>(peaks[i].second_px)};
      // Whether there is a line or not: nobody can tell beforehand.
      take_row<kSignal, kSubtract>(s, i, row_of(job.on, i), kSubtract ? row_of(job.off, i) : nullptr, job.width_px,
                                   peaks[i].center_px, job.options);
      if (!found) s.window[i].kind = WindowKind::none;
    });
  }
  refine_windows(job);
}

template <Signal kSignal, bool kSubtract>
struct ExtractRows {
  static void run(const Job& job) {
    for (int row = 0; row < job.height_px; row += kBlockRows) {
      extract_block<kSignal, kSubtract>(job, row, std::min(kBlockRows, job.height_px - row));
    }
  }
};

template <Signal kSignal, bool kSubtract>
struct RefineChosen {
  /// In the blocks that extraction has: a row's neighbours do not depend on how a frame was cut into strips.
  static void run(const Job& job) {
    for (auto choice = job.chosen.begin(); choice != job.chosen.end();) {
      Scratch& s = *job.scratch;
      for (Window& window : s.window) window.kind = WindowKind::none;
      const int first_row = choice->row / kBlockRows * kBlockRows;
      for (; choice != job.chosen.end() && choice->row < first_row + kBlockRows; ++choice) {
        LineRow& row = job.rows[static_cast<std::size_t>(choice->row)];
        row = {};
        row.status = RowStatus::ambiguous;
        if (choice->center_px < 0) continue;
        const int i = choice->row - first_row;
        s.frame_row[i] = choice->row;
        const std::size_t offset = static_cast<std::size_t>(choice->row) * job.stride_bytes;
        take_row<kSignal, kSubtract>(s, i, job.on + offset, kSubtract ? job.off + offset : nullptr, job.width_px,
                                     choice->center_px, job.options);
      }
      refine_windows(job);
    }
  }
};

template <template <Signal, bool> class Step, Signal kSignal>
void run_signal(const Job& job) {
  job.off != nullptr ? Step<kSignal, true>::run(job) : Step<kSignal, false>::run(job);
}

template <template <Signal, bool> class Step>
void run(const Job& job) {
  switch (job.signal) {
    case Signal::grey:
      return run_signal<Step, Signal::grey>(job);
    case Signal::yuyv_luma:
      return run_signal<Step, Signal::yuyv_luma>(job);
    case Signal::yuyv_red:
      return run_signal<Step, Signal::yuyv_red>(job);
    case Signal::yuyv_green:
      return run_signal<Step, Signal::yuyv_green>(job);
  }
}

void extract_frame(const Job& job) {
  run<ExtractRows>(job);
}

void refine_chosen_rows(const Job& job) {
  run<RefineChosen>(job);
}

void turn_columns(const Strip& strip) {
  switch (strip.signal) {
    case Signal::grey:
      return turn<Signal::grey>(strip);
    case Signal::yuyv_luma:
      return turn<Signal::yuyv_luma>(strip);
    case Signal::yuyv_red:
      return turn<Signal::yuyv_red>(strip);
    case Signal::yuyv_green:
      return turn<Signal::yuyv_green>(strip);
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
HWY_EXPORT(refine_chosen_rows);
HWY_EXPORT(turn_columns);
HWY_EXPORT(target_name);

void extract(const Job& job) {
  HWY_DYNAMIC_DISPATCH(extract_frame)(job);
}
void refine_chosen(const Job& job) {
  HWY_DYNAMIC_DISPATCH(refine_chosen_rows)(job);
}
void turn_strip(const Strip& strip) {
  HWY_DYNAMIC_DISPATCH(turn_columns)(strip);
}
const char* simd_target() {
  return HWY_DYNAMIC_DISPATCH(target_name)();
}

}  // namespace celadon::line_kernels
#endif
