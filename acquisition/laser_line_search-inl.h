// Coarse search of the laser line in one row: decimation by 4, score, first and second maximum. Included once for each
// SIMD target by laser_line_simd.cpp. README.md, "Line extraction", steps 1 to 3.
#if defined(CELADON_LASER_LINE_SEARCH_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CELADON_LASER_LINE_SEARCH_INL_H_
#undef CELADON_LASER_LINE_SEARCH_INL_H_
#else
#define CELADON_LASER_LINE_SEARCH_INL_H_
#endif

#include <cstring>

#include "acquisition/laser_line_kernels.h"
#include "hwy/cache_control.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace celadon::line_kernels {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// At most 64 lanes: padding and scratch memory are made for these.
using D8 = hn::CappedTag<std::uint8_t, 64>;
using V8 = hn::VFromD<D8>;
/// For frames too narrow for D8: 16 cells, the narrowest row allowed.
using DNarrow = hn::CappedTag<std::uint8_t, 16>;

/// Calls f(i) for i = 0, N, 2N ... and once more for the last N of `count`: no read or write beyond. @pre count >= N
template <class F>
HWY_INLINE void for_each_vector(int count, int lanes, F&& f) {
  int i = 0;
  for (; i + lanes <= count; i += lanes) f(i);
  if (i < count) f(count - lanes);
}

/// Rounded means of neighbouring bytes of two vectors, in order.
template <class D, class V>
HWY_INLINE V halve(D d, V low, V high) {
  const hn::RepartitionToWide<D> d16;
  const auto mean = [&](V v) { return hn::AverageRound(v, hn::BitCast(d, hn::ShiftRight<8>(hn::BitCast(d16, v)))); };
  return hn::ConcatEven(d, mean(high), mean(low));
}

/// Red or green of cells from their luma and chroma, 16 bits, not limited to 0..255.
template <Signal kSignal, class DI, class VI>
HWY_INLINE VI colour(DI di, VI y, VI u, VI v) {
  v = hn::Sub(v, hn::Set(di, 128));
  if constexpr (kSignal == Signal::yuyv_red) {
    return hn::Add(y, hn::Add(v, hn::ShiftRight<9>(hn::Mul(v, hn::Set(di, 206)))));
  } else {
    u = hn::Sub(u, hn::Set(di, 128));
    return hn::Sub(y, hn::ShiftRight<7>(hn::Add(hn::Mul(u, hn::Set(di, 44)), hn::Mul(v, hn::Set(di, 91)))));
  }
}

/// Luma and chroma of as many cells as D has lanes, from YUYV.
template <class V>
struct YuvCells {
  V y, u, v;
};

template <class D, class V = hn::VFromD<D>>
HWY_INLINE YuvCells<V> yuv_cells(D d, const std::uint8_t* bytes) {
  const auto lanes = hn::Lanes(d);
  const auto raw = [&](std::size_t i) { return hn::LoadU(d, bytes + i * lanes); };
  const auto luma = [&](std::size_t i) { return hn::ConcatEven(d, raw(2 * i + 1), raw(2 * i)); };
  const auto chroma = [&](std::size_t i) { return hn::ConcatOdd(d, raw(2 * i + 1), raw(2 * i)); };  // U V U V
  const auto chroma0 = chroma(0), chroma1 = chroma(1), chroma2 = chroma(2), chroma3 = chroma(3);
  return {halve(d, halve(d, luma(0), luma(1)), halve(d, luma(2), luma(3))),
          halve(d, hn::ConcatEven(d, chroma1, chroma0), hn::ConcatEven(d, chroma3, chroma2)),
          halve(d, hn::ConcatOdd(d, chroma1, chroma0), hn::ConcatOdd(d, chroma3, chroma2))};
}

template <Signal kSignal, bool kSubtract, class D>
HWY_INLINE void store_colour_cells(D d, const std::uint8_t* on, const std::uint8_t* off, std::uint8_t* out) {
  const hn::Half<D> half;
  const hn::Rebind<std::int16_t, hn::Half<D>> di;
  const auto widened = [&](const auto& cells, bool upper) {
    const auto wide = [&](auto v) {
      return hn::PromoteTo(di, upper ? hn::UpperHalf(half, v) : hn::LowerHalf(half, v));
    };
    return colour<kSignal>(di, wide(cells.y), wide(cells.u), wide(cells.v));
  };
  const auto lit = yuv_cells(d, on);
  auto low = widened(lit, false), high = widened(lit, true);
  if constexpr (kSubtract) {
    const auto dark = yuv_cells(d, off);
    low = hn::Sub(low, widened(dark, false));
    high = hn::Sub(high, widened(dark, true));
  }
  hn::StoreU(hn::DemoteTo(half, low), half, out);
  hn::StoreU(hn::DemoteTo(half, high), half, out + hn::Lanes(half));
}

/// One cell (mean signal) for each 4 pixels; the bytes at `next` (two rows ahead) are asked for while this row is read.
template <Signal kSignal, bool kSubtract, class D>
HWY_INLINE void decimate(D d, const std::uint8_t* on, const std::uint8_t* off, std::ptrdiff_t next, int cell_count,
                         std::uint8_t* cells) {
  constexpr int kBytesPerCell = kSignal == Signal::grey ? 4 : 8;
  const int lanes = static_cast<int>(hn::Lanes(d));
  for_each_vector(cell_count, lanes, [&](int cell) {
    const std::uint8_t* lit = on + cell * kBytesPerCell;
    const std::uint8_t* dark = kSubtract ? off + cell * kBytesPerCell : nullptr;
    for (int line = 0; line < lanes * kBytesPerCell; line += 64) {
      hwy::Prefetch(lit + next + line);
      if constexpr (kSubtract) hwy::Prefetch(dark + next + line);
    }
    if constexpr (kSignal == Signal::grey || kSignal == Signal::yuyv_luma) {
      const auto bytes = [&](int i) {
        const auto v = hn::LoadU(d, lit + i * lanes);
        if constexpr (kSubtract) return hn::SaturatedSub(v, hn::LoadU(d, dark + i * lanes));
        return v;
      };
      const auto pixels = [&](int i) {
        if constexpr (kSignal == Signal::yuyv_luma) return hn::ConcatEven(d, bytes(2 * i + 1), bytes(2 * i));
        return bytes(i);
      };
      hn::StoreU(halve(d, halve(d, pixels(0), pixels(1)), halve(d, pixels(2), pixels(3))), d, cells + cell);
    } else {
      store_colour_cells<kSignal, kSubtract>(d, lit, dark, cells + cell);
    }
  });
}

HWY_INLINE int largest(V8 v) {
  const hn::RepartitionToWide<D8> d;
  const auto pair = hn::BitCast(d, v);
  return hn::GetLane(hn::MaxOfLanes(d, hn::Max(hn::And(pair, hn::Set(d, 0xFF)), hn::ShiftRight<8>(pair))));
}

struct CoarsePeak {
  int score = 0;         ///< largest
  int second_score = 0;  ///< largest further than 6 cells from it
  int center_px = 0;
};

/// Mean of 8 pixels less the larger of those 12 to the left and to the right: a line stands out, an edge or a gradient
/// does not. @pre cells[-kPaddingCells .. cell_count + kPaddingCells) can be written
HWY_INLINE CoarsePeak coarse_peak(std::uint8_t* cells, std::uint8_t* scores, int cell_count, int minimum_score) {
  const D8 d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  hn::StoreU(hn::Set(d, cells[0]), d, cells - lanes);
  const auto last = hn::Set(d, cells[cell_count - 1]);
  hn::StoreU(last, d, cells + cell_count);
  hn::StoreU(last, d, cells + cell_count + lanes);
  const auto mean_of_8_px = [&](int i) {
    return hn::AverageRound(hn::LoadU(d, cells + i), hn::LoadU(d, cells + i + 1));
  };
  auto highest = hn::Zero(d);
  for (int i = 0; i < cell_count; i += lanes) {
    const auto score = hn::SaturatedSub(mean_of_8_px(i), hn::Max(mean_of_8_px(i - 3), mean_of_8_px(i + 3)));
    hn::Store(score, d, scores + i);
    highest = hn::Max(highest, score);
  }
  CoarsePeak peak;
  peak.score = largest(highest);
  if (peak.score < minimum_score) return peak;
  const auto wanted = hn::Set(d, static_cast<std::uint8_t>(peak.score));
  int cell = 0;
  for (int i = 0; i < cell_count; i += lanes) {
    const auto found = hn::FindFirstTrue(d, hn::Eq(hn::Load(d, scores + i), wanted));
    if (found >= 0) {
      cell = i + static_cast<int>(found);
      break;
    }
  }
  std::memset(scores + cell - 6, 0, 13);
  highest = hn::Zero(d);
  for (int i = 0; i < cell_count; i += lanes) highest = hn::Max(highest, hn::Load(d, scores + i));
  peak.second_score = largest(highest);
  peak.center_px = 4 * cell + 4;
  return peak;
}

}  // namespace HWY_NAMESPACE
}  // namespace celadon::line_kernels
HWY_AFTER_NAMESPACE();
#endif
