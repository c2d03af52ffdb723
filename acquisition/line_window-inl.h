// The pixels about a row's coarse peak, 16 bits, and their transposition to one row a SIMD lane. Included once for each
// SIMD target by laser_line_simd.cpp.
#if defined(CELADON_LINE_WINDOW_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CELADON_LINE_WINDOW_INL_H_
#undef CELADON_LINE_WINDOW_INL_H_
#else
#define CELADON_LINE_WINDOW_INL_H_
#endif

#include <algorithm>
#include <cstring>

#include "acquisition/laser_line_kernels.h"
#include "acquisition/laser_line_search-inl.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace celadon::line_kernels {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

/// Pixels to a vector of signals.
using DPx = hn::CappedTag<std::int16_t, 16>;
using VPx = hn::VFromD<DPx>;

/// Signal of the pixels px, px + 1 ..., not limited to 0..255. @pre px is even
template <Signal kSignal, class D>
HWY_INLINE hn::VFromD<D> signals_at(D d, const std::uint8_t* row, int px) {
  if constexpr (kSignal == Signal::grey) {
    return hn::PromoteTo(d, hn::LoadU(hn::Rebind<std::uint8_t, D>(), row + px));
  } else {
    const hn::Repartition<std::uint8_t, D> d8;
    const hn::RebindToUnsigned<D> d16;
    const hn::RepartitionToWide<decltype(d16)> d32;
    const auto bytes = hn::BitCast(d16, hn::LoadU(d8, row + 2 * px));
    const auto y = hn::BitCast(d, hn::And(bytes, hn::Set(d16, 0xFF)));
    if constexpr (kSignal == Signal::yuyv_luma) return y;
    const auto chroma = hn::BitCast(d32, chroma_of(d, bytes));  // U in the lower half, V in the upper
    const auto lower = hn::And(chroma, hn::Set(d32, 0xFFFF)), upper = hn::ShiftRight<16>(chroma);
    const auto u = hn::BitCast(d, hn::Or(lower, hn::ShiftLeft<16>(lower)));
    const auto v = hn::BitCast(d, hn::Or(upper, hn::ShiftLeft<16>(upper)));
    return colour<kSignal>(d, y, u, v);
  }
}

/// The same of one pixel.
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

/// Sum of the signal of 4 pixels at each side of the window, from its 8th and to its 8th last: light that is not the
/// line's.
template <Signal kSignal>
HWY_INLINE int ambient_sum(const std::uint8_t* row, int first, int width) {
  constexpr int kLeftPx = 8, kRightPx = 52, kPx = 4;
  if (first >= 0 && first + kWindowPx <= width) {
    const hn::CappedTag<std::int16_t, 4> d;
    const auto at = [&](int px) HWY_ATTR { return signals_at<kSignal>(d, row, first + px); };
    return hn::GetLane(hn::SumOfLanes(d, hn::Add(at(kLeftPx), at(kRightPx))));
  }
  int sum = 0;
  for (int i = 0; i < kPx; ++i) {
    for (const int start : {kLeftPx, kRightPx}) {
      sum += signal_at<kSignal>(row, std::clamp(first + start + i, 0, width - 1));
    }
  }
  return sum;
}

/// Cuts row `row` of the block. Pixels beyond the frame repeat the last one and cannot be used.
template <Signal kSignal, bool kSubtract>
HWY_INLINE void cut_window(Scratch& s, int row, const std::uint8_t* on, const std::uint8_t* off, int width,
                           int center) {
  const DPx d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const int first = center - kWindowPx / 2;
  const bool inside = first >= 0 && first + kWindowPx <= width;
  std::int16_t* cut = s.cut[row];
  Window& window = s.window[row];
  const auto clipped = [&](VPx v) HWY_ATTR {
    if constexpr (!kSubtract && (kSignal == Signal::grey || kSignal == Signal::yuyv_luma)) return v;
    return hn::Min(hn::Max(v, hn::Set(d, -64)), hn::Set(d, 255));
  };
  window.saturated = false;
  if (inside) {
    const auto level = hn::Set(d, s.saturated_level);
    auto highest = hn::Zero(d);
    for (int i = 0; i < kWindowPx; i += lanes) {
      const auto lit = signals_at<kSignal>(d, on, first + i);
      highest = hn::Max(highest, lit);
      auto value = lit;
      if constexpr (kSubtract) value = hn::Sub(lit, signals_at<kSignal>(d, off, first + i));
      hn::Store(clipped(value), d, cut + i);
      hn::Store(hn::VecFromMask(d, hn::Lt(lit, level)), d, s.usable[row] + i);
    }
    window.saturated = !hn::AllTrue(d, hn::Lt(highest, level));
    window.kind = window.saturated ? WindowKind::partial : WindowKind::whole;
    return;
  }
  window.kind = WindowKind::partial;
  for (int i = 0; i < kWindowPx; ++i) {
    const int px = std::clamp(first + i, 0, width - 1), lit = signal_at<kSignal>(on, px);
    const int value = kSubtract ? lit - signal_at<kSignal>(off, px) : lit;
    const bool saturated = lit >= s.saturated_level;
    cut[i] = static_cast<std::int16_t>(std::clamp(value, -64, 255));
    s.usable[row][i] = saturated || px != first + i ? 0 : -1;
    window.saturated = window.saturated || saturated;
  }
}

/// Cuts the window and tells the noise of its pixels: read noise, rounding, and the shot noise of the ambient light, of
/// both frames if there are two.
template <Signal kSignal, bool kSubtract>
HWY_INLINE void take_row(Scratch& s, int row, const std::uint8_t* on, const std::uint8_t* off, int width, int center,
                         const LaserLineOptions& options) {
  cut_window<kSignal, kSubtract>(s, row, on, off, width, center);
  s.window[row].center_px = center;
  const int sum = ambient_sum<kSignal>(kSubtract ? off : on, center - kWindowPx / 2, width);
  s.window[row].ambient_variance =
      (kSubtract ? 2.f : 1.f) * (options.read_noise * options.read_noise + 1.f / 12 +
                                 static_cast<float>(std::max(sum, 0)) / 8 / options.electrons_per_level);
}

/// Gives the rows of the block their lanes.
HWY_INLINE void assign_lanes(Scratch& s, bool any_partial) {
  int whole = 0, partial = kBlockRows;
  for (int i = 0; i < kBlockRows; ++i) {
    partial -= s.window[i].kind == WindowKind::partial ? 1 : 0;
    s.row[i] = i;
    s.kind[i] = any_partial ? WindowKind::none : s.window[i].kind;
  }
  for (int i = 0; any_partial && i < kBlockRows; ++i) {
    const WindowKind kind = s.window[i].kind;
    if (kind == WindowKind::none) continue;
    const int is_whole = kind == WindowKind::whole ? 1 : 0;  // no branch: nobody can tell which rows are saturated
    const int lane = is_whole != 0 ? whole : partial;
    whole += is_whole;
    partial += 1 - is_whole;
    s.row[lane] = i;
    s.kind[lane] = kind;
  }
  for (int lane = 0; lane < kBlockRows; ++lane) s.ambient_variance[lane] = s.window[s.row[lane]].ambient_variance;
}

/// out[pixel][lane] = in[row_of[lane]][pixel], 8 rows and 8 pixels at a time.
HWY_INLINE void transpose(const std::int16_t (*in)[kWindowPx], const int* row_of, std::int16_t (*out)[kBlockRows]) {
  const hn::CappedTag<std::int16_t, 8> d;
  const hn::RepartitionToWide<decltype(d)> d32;
  const hn::RepartitionToWide<decltype(d32)> d64;
  for (int row = 0; row < kBlockRows; row += 8) {
    for (int px = 0; px < kWindowPx; px += 8) {
      const auto load = [&](int i) HWY_ATTR { return hn::Load(d, in[row_of[row + i]] + px); };
      const auto low16 = [&](auto a, auto b) HWY_ATTR { return hn::BitCast(d32, hn::InterleaveLower(d, a, b)); };
      const auto high16 = [&](auto a, auto b) HWY_ATTR { return hn::BitCast(d32, hn::InterleaveUpper(d, a, b)); };
      const auto low32 = [&](auto a, auto b) HWY_ATTR { return hn::BitCast(d64, hn::InterleaveLower(d32, a, b)); };
      const auto high32 = [&](auto a, auto b) HWY_ATTR { return hn::BitCast(d64, hn::InterleaveUpper(d32, a, b)); };
      const auto r0 = load(0), r1 = load(1), r2 = load(2), r3 = load(3);
      const auto r4 = load(4), r5 = load(5), r6 = load(6), r7 = load(7);
      const auto a0 = low16(r0, r1), a1 = low16(r2, r3), a2 = low16(r4, r5), a3 = low16(r6, r7);
      const auto b0 = high16(r0, r1), b1 = high16(r2, r3), b2 = high16(r4, r5), b3 = high16(r6, r7);
      const auto store = [&](int i, auto a, auto b) HWY_ATTR {
        hn::Store(hn::BitCast(d, hn::InterleaveLower(d64, a, b)), d, out[px + i] + row);
        hn::Store(hn::BitCast(d, hn::InterleaveUpper(d64, a, b)), d, out[px + i + 1] + row);
      };
      store(0, low32(a0, a1), low32(a2, a3));
      store(2, high32(a0, a1), high32(a2, a3));
      store(4, low32(b0, b1), low32(b2, b3));
      store(6, high32(b0, b1), high32(b2, b3));
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace celadon::line_kernels
HWY_AFTER_NAMESPACE();
#endif
