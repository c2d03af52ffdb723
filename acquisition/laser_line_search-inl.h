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

// At most 64 bytes, so that the narrowest row allowed fills a vector.
using D8 = hn::CappedTag<std::uint8_t, 64>;
using D16 = hn::Repartition<std::uint16_t, D8>;
using DI16 = hn::Repartition<std::int16_t, D8>;
using D32 = hn::Repartition<std::uint32_t, D8>;
using D64 = hn::Repartition<std::uint64_t, D8>;
using V8 = hn::VFromD<D8>;
using VI16 = hn::VFromD<DI16>;

/// Calls f(i) for i = 0, N, 2N ... and once more for the last N of `count`: no read or write beyond. @pre count >= N
template <class F>
HWY_INLINE void for_each_vector(int count, int lanes, F&& f) {
  int i = 0;
  for (; i + lanes <= count; i += lanes) f(i);
  if (i < count) f(count - lanes);
}

/// Mean of each 4 neighbouring bytes, stored as one byte each.
HWY_INLINE void store_mean_of_4(V8 v, std::uint8_t* out) {
  const D8 d;
  const hn::Rebind<std::uint8_t, D32> quarter;
  v = hn::AverageRound(v, hn::BitCast(d, hn::ShiftRight<8>(hn::BitCast(D16(), v))));
  v = hn::AverageRound(v, hn::BitCast(d, hn::ShiftRight<16>(hn::BitCast(D32(), v))));
  hn::StoreU(hn::TruncateTo(quarter, hn::BitCast(D32(), v)), quarter, out);
}

/// Mean of each 4 neighbouring 16-bit values in the lowest of them.
template <class V16>
HWY_INLINE hn::VFromD<D16> mean_of_4(V16 v) {
  const D16 d;
  auto mean = hn::AverageRound(v, hn::BitCast(d, hn::ShiftRight<16>(hn::BitCast(D32(), v))));
  return hn::AverageRound(mean, hn::BitCast(d, hn::ShiftRight<32>(hn::BitCast(D64(), mean))));
}

/// Lowest byte of each 8.
template <class V16>
HWY_INLINE void store_low_of_8(V16 v, std::uint8_t* out) {
  const hn::Rebind<std::uint8_t, D64> eighth;
  hn::StoreU(hn::TruncateTo(eighth, hn::BitCast(D64(), v)), eighth, out);
}

HWY_INLINE hn::VFromD<D16> luma_of_yuyv(V8 v) {
  return hn::And(hn::BitCast(D16(), v), hn::Set(D16(), 0xFF));
}

/// Red or green of each 4 pixels of YUYV (8 bytes), in the lowest 16 bits, not limited to 0..255.
template <Signal kSignal>
HWY_INLINE VI16 colour_of_4(V8 v) {
  const D16 d;
  const DI16 di;
  const auto luma = hn::BitCast(di, mean_of_4(luma_of_yuyv(v)));
  const auto chroma = hn::ShiftRight<8>(hn::BitCast(d, v));  // U V U V
  const auto mean = hn::AverageRound(chroma, hn::BitCast(d, hn::ShiftRight<32>(hn::BitCast(D64(), chroma))));
  const auto v_mean = hn::BitCast(di, hn::ShiftRight<16>(hn::BitCast(D64(), mean)));
  const auto v_signed = hn::Sub(v_mean, hn::Set(di, 128));
  if constexpr (kSignal == Signal::yuyv_red) {
    return hn::Add(luma, hn::Add(v_signed, hn::ShiftRight<9>(hn::Mul(v_signed, hn::Set(di, 206)))));
  } else {
    const auto u_signed = hn::Sub(hn::BitCast(di, mean), hn::Set(di, 128));
    const auto excess = hn::Add(hn::Mul(u_signed, hn::Set(di, 44)), hn::Mul(v_signed, hn::Set(di, 91)));
    return hn::Sub(luma, hn::ShiftRight<7>(excess));
  }
}

/// One cell for each 4 pixels; the bytes at `next` (two rows ahead) are asked for while this row is read.
template <Signal kSignal, bool kSubtract>
HWY_INLINE void decimate(const std::uint8_t* on, const std::uint8_t* off, std::ptrdiff_t next, int cell_count,
                         std::uint8_t* cells) {
  const D8 d;
  constexpr int kBytesPerCell = kSignal == Signal::grey ? 4 : 8;
  for_each_vector(cell_count * kBytesPerCell, static_cast<int>(hn::Lanes(d)), [&](int i) {
    hwy::Prefetch(on + i + next);
    const auto v = hn::LoadU(d, on + i);
    auto u = hn::Zero(d);
    if constexpr (kSubtract) {
      hwy::Prefetch(off + i + next);
      u = hn::LoadU(d, off + i);
    }
    std::uint8_t* out = cells + i / kBytesPerCell;
    if constexpr (kSignal == Signal::grey) {
      store_mean_of_4(kSubtract ? hn::SaturatedSub(v, u) : v, out);
    } else if constexpr (kSignal == Signal::yuyv_luma) {
      store_low_of_8(mean_of_4(luma_of_yuyv(kSubtract ? hn::SaturatedSub(v, u) : v)), out);
    } else {
      const DI16 di;
      auto colour = colour_of_4<kSignal>(v);
      if constexpr (kSubtract) colour = hn::Sub(colour, colour_of_4<kSignal>(u));
      store_low_of_8(hn::Min(hn::Max(colour, hn::Zero(di)), hn::Set(di, 255)), out);
    }
  });
}

HWY_INLINE int largest(V8 v) {
  const D16 d;
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
  std::memset(cells - 4, cells[0], 4);
  std::memset(cells + cell_count, cells[cell_count - 1], kPaddingCells);
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
