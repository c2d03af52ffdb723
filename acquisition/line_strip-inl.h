// Columns of a frame to rows of a grey picture, 16 x 16 pixels at a time in registers. Included once for each SIMD
// target by laser_line_simd.cpp. README.md, "Line extraction", "Lines along columns".
#if defined(CELADON_LINE_STRIP_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CELADON_LINE_STRIP_INL_H_
#undef CELADON_LINE_STRIP_INL_H_
#else
#define CELADON_LINE_STRIP_INL_H_
#endif

#include <algorithm>

#include "acquisition/laser_line_kernels.h"
#include "acquisition/line_window-inl.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace celadon::line_kernels {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using DTile = hn::CappedTag<std::uint8_t, kTilePx>;
using VTile = hn::VFromD<DTile>;

/// Signal of 16 pixels from px on, limited to 0..255. @pre px is even
template <Signal kSignal>
HWY_INLINE VTile tile_row(const std::uint8_t* row, int px) {
  const DTile d;
  if constexpr (kSignal == Signal::grey) {
    return hn::LoadU(d, row + px);
  } else if constexpr (kSignal == Signal::yuyv_luma) {
    return hn::ConcatEven(d, hn::LoadU(d, row + 2 * px + kTilePx), hn::LoadU(d, row + 2 * px));
  } else {
    const hn::CappedTag<std::int16_t, kTilePx / 2> d16;
    const hn::Half<DTile> d_half;
    return hn::Combine(d, hn::DemoteTo(d_half, signals_at<kSignal>(d16, row, px + kTilePx / 2)),
                       hn::DemoteTo(d_half, signals_at<kSignal>(d16, row, px)));
  }
}

/// One step of four: from the place (row, column) of a pixel, eight bits, to those bits turned by one to the left.
HWY_INLINE void shuffle(const VTile (&in)[kTilePx], VTile (&out)[kTilePx]) {
  const DTile d;
  for (int i = 0; i < kTilePx / 2; ++i) {
    out[2 * i] = hn::InterleaveLower(d, in[i], in[i + kTilePx / 2]);
    out[2 * i + 1] = hn::InterleaveUpper(d, in[i], in[i + kTilePx / 2]);
  }
}

/// Rows and columns from (px, row) on change places.
template <Signal kSignal>
HWY_INLINE void turn_tile(const Strip& strip, int px, int row) {
  const std::uint8_t* from = strip.frame + static_cast<std::size_t>(row) * strip.stride_bytes;
  std::uint8_t* to = strip.out + static_cast<std::size_t>(px - strip.first_px) * strip.out_stride_bytes + row;
  VTile a[kTilePx], b[kTilePx];
  for (int i = 0; i < kTilePx; ++i)
    a[i] = tile_row<kSignal>(from + static_cast<std::size_t>(i) * strip.stride_bytes, px);
  shuffle(a, b);
  shuffle(b, a);
  shuffle(a, b);
  shuffle(b, a);
  for (int i = 0; i < kTilePx; ++i)
    hn::StoreU(a[i], DTile(), to + static_cast<std::size_t>(i) * strip.out_stride_bytes);
}

template <Signal kSignal>
void turn(const Strip& strip) {
  constexpr std::size_t kBytesPerPx = kSignal == Signal::grey ? 1 : 2, kLineBytes = 64;
  constexpr int kRowsAhead = 2 * kTilePx;
  const int last_px = strip.first_px + strip.width_px - kTilePx, last_row = strip.height_px - kTilePx;
  for (int row = 0; row < strip.height_px; row += kTilePx) {
    for (int i = 0; i < kTilePx; ++i) {
      const int ahead = std::min(row + kRowsAhead + i, strip.height_px - 1);
      const std::uint8_t* bytes = strip.frame + static_cast<std::size_t>(ahead) * strip.stride_bytes +
                                  static_cast<std::size_t>(strip.first_px) * kBytesPerPx;
      for (std::size_t at = 0; at < static_cast<std::size_t>(strip.width_px) * kBytesPerPx; at += kLineBytes) {
        __builtin_prefetch(bytes + at);
      }
    }
    // The last tiles lie over those before: no read or write beyond.
    for (int px = strip.first_px; px < strip.first_px + strip.width_px; px += kTilePx) {
      turn_tile<kSignal>(strip, std::min(px, last_px), std::min(row, last_row));
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace celadon::line_kernels
HWY_AFTER_NAMESPACE();
#endif
