// Coarse search of the laser line in one row: decimation by 4, score, first and second maximum. Included once for each
// SIMD target by laser_line_simd.cpp. README.md, "Line extraction", steps 1 to 3.
#if defined(CELADON_LASER_LINE_SEARCH_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CELADON_LASER_LINE_SEARCH_INL_H_
#undef CELADON_LASER_LINE_SEARCH_INL_H_
#else
#define CELADON_LASER_LINE_SEARCH_INL_H_
#endif

#include "acquisition/laser_line_kernels.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace celadon::line_kernels {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

/// At most 32 lanes: of loads from unaligned places, longer ones would all take two lines of the cache.
using D8 = hn::CappedTag<std::uint8_t, 32>;
using V8 = hn::VFromD<D8>;
/// For frames too narrow for D8: 16 cells, the narrowest row allowed.
using DNarrow = hn::CappedTag<std::uint8_t, 16>;

/// The largest score of a line is over this many times the mean of the scores away from it; that of white noise is so
/// in fewer than one row in 500.
inline constexpr int kNoiseFactor = 22;

/// Bytes of four vectors, of which lane i of 32 bits holds cell i of the first in its lowest byte, cell i of the second
/// in the next and so on, in the order of the cells.
template <class D, class V>
HWY_INLINE V in_order(D d, V v) {
  const hn::Repartition<std::uint32_t, D> d32;
  alignas(16) static constexpr std::uint8_t kBytes[16] = {0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15};
  const auto blocks = hn::BitCast(d32, hn::TableLookupBytes(v, hn::LoadDup128(d, kBytes)));
  constexpr std::size_t kLanes32 = hn::MaxLanes(d32);
  if constexpr (kLanes32 <= 4) return hn::BitCast(d, blocks);
  alignas(64) std::uint32_t order[kLanes32];
  for (std::size_t i = 0; i < kLanes32; ++i) {
    order[i] = static_cast<std::uint32_t>(4 * (i % (kLanes32 / 4)) + i / (kLanes32 / 4));
  }
  return hn::BitCast(d, hn::TableLookupLanes(blocks, hn::SetTableIndices(d32, order)));
}

/// Grey value or luma, on less off, of the i-th vector of pixels, `further` (-1, 0 or 1) pixels further; of the pixel
/// before the first or after the last whatever.
template <Signal kSignal, bool kSubtract, class D>
HWY_INLINE auto pixels(D d, const std::uint8_t* on, const std::uint8_t* off, int i, int further) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  if constexpr (kSignal == Signal::grey && !kSubtract) {
    return hn::LoadU(d, on + i * lanes + further);  // costs less than a shift
  } else {
    const hn::RepartitionToWide<D> d16;
    auto v = hn::LoadU(d, on + i * lanes);
    if constexpr (kSignal == Signal::yuyv_luma) {
      v = hn::ConcatEven(d, hn::LoadU(d, on + (2 * i + 1) * lanes), hn::LoadU(d, on + 2 * i * lanes));
      if constexpr (kSubtract) {
        v = hn::SaturatedSub(
            v, hn::ConcatEven(d, hn::LoadU(d, off + (2 * i + 1) * lanes), hn::LoadU(d, off + 2 * i * lanes)));
      }
    } else {
      v = hn::SaturatedSub(v, hn::LoadU(d, off + i * lanes));
    }
    if (further == 0) return v;
    const auto pairs = hn::BitCast(d16, v);
    return hn::BitCast(d, further > 0 ? hn::ShiftRight<8>(pairs) : hn::ShiftLeft<8>(pairs));
  }
}

/// Means of the pixels' pairs: those of vector `even` in the even bytes, of vector `odd` in the odd.
template <Signal kSignal, bool kSubtract, class D>
HWY_INLINE auto means_of_2(D d, const std::uint8_t* on, const std::uint8_t* off, int even, int odd) {
  const auto at = [&](int i, int further) HWY_ATTR { return pixels<kSignal, kSubtract>(d, on, off, i, further); };
  return hn::OddEven(hn::AverageRound(at(odd, 0), at(odd, -1)), hn::AverageRound(at(even, 0), at(even, 1)));
}

/// Means of 4 neighbouring pixels of four vectors: mean(mean, mean), each rounded up.
template <Signal kSignal, bool kSubtract, class D>
HWY_INLINE auto means_of_4(D d, const std::uint8_t* on, const std::uint8_t* off) {
  const hn::RepartitionToWide<D> d16;
  const hn::RepartitionToWide<decltype(d16)> d32;
  const auto low = means_of_2<kSignal, kSubtract>(d, on, off, 0, 1);
  const auto high = means_of_2<kSignal, kSubtract>(d, on, off, 2, 3);
  const auto low_means = hn::AverageRound(low, hn::BitCast(d, hn::ShiftRight<16>(hn::BitCast(d32, low))));
  const auto high_means = hn::AverageRound(high, hn::BitCast(d, hn::ShiftLeft<16>(hn::BitCast(d32, high))));
  const auto quads = hn::OddEven(hn::BitCast(d16, high_means), hn::BitCast(d16, low_means));
  return in_order(d, hn::BitCast(d, quads));
}

/// 256 (chroma - 128) from 16-bit lanes with the chroma in their upper byte.
template <class DI, class V16>
HWY_INLINE auto chroma_of(DI di, V16 v) {
  const hn::RebindToUnsigned<DI> d16;
  return hn::BitCast(di, hn::Xor(hn::And(v, hn::Set(d16, 0xFF00)), hn::Set(d16, 0x8000)));
}

/// Red or green from luma and 256 times the chroma, 16 bits, not limited to 0..255.
template <Signal kSignal, class DI, class VI>
HWY_INLINE VI colour(DI di, VI y, VI u256, VI v256) {
  if constexpr (kSignal == Signal::yuyv_red) {
    return hn::Add(y, hn::MulHigh(v256, hn::Set(di, 256 + 103)));
  } else {
    const auto u = hn::ShiftRight<8>(u256), v = hn::ShiftRight<8>(v256);
    return hn::Sub(y, hn::ShiftRight<7>(hn::Add(hn::Mul(u, hn::Set(di, 44)), hn::Mul(v, hn::Set(di, 91)))));
  }
}

/// Means over 4 pixels (Y0 U0 Y1 V0 Y2 U1 Y3 V1) of YUYV: Y02 U Y13 V in 32 bits for each cell of two vectors, in turn
/// from the first and the second.
template <class D>
HWY_INLINE auto yuv_means(D d, const std::uint8_t* bytes) {
  const hn::RepartitionToWide<hn::RepartitionToWide<D>> d32;
  const std::uint8_t* second = bytes + hn::Lanes(d);
  const auto low = hn::AverageRound(hn::LoadU(d, bytes), hn::LoadU(d, bytes + 4));
  const auto high = hn::AverageRound(hn::LoadU(d, second), hn::LoadU(d, second - 4));
  return hn::OddEven(hn::BitCast(d32, high), hn::BitCast(d32, low));
}

/// Red or green of cells in 16 bits: those of one pair of vectors in the lower half of each 32 bits, of another above.
template <Signal kSignal, class D>
HWY_INLINE auto colours(D d, const std::uint8_t* lower, const std::uint8_t* upper) {
  const hn::RepartitionToWide<D> d16;
  const hn::RebindToSigned<decltype(d16)> di;
  const auto as16 = [&](auto v) HWY_ATTR { return hn::BitCast(d16, v); };
  const auto a = yuv_means(d, lower), b = yuv_means(d, upper);
  // Y02 U and Y13 V, of the lower cell and of the upper.
  const auto y_u = hn::OddEven(as16(hn::ShiftLeft<16>(b)), as16(a));
  const auto y_v = hn::OddEven(as16(b), as16(hn::ShiftRight<16>(a)));
  const auto y = hn::And(as16(hn::AverageRound(hn::BitCast(d, y_u), hn::BitCast(d, y_v))), hn::Set(d16, 0xFF));
  return colour<kSignal>(di, hn::BitCast(di, y), chroma_of(di, y_u), chroma_of(di, y_v));
}

/// Bytes of four pairs of vectors as yuv_means() leaves them, one of each pair in each 32 bits, in the order of the
/// cells: those of a block by pairs, the blocks by pairs, then the blocks of each vector together.
template <class D, class V>
HWY_INLINE V pairs_in_order(D d, V v) {
  const hn::Repartition<std::uint32_t, D> d32;
  alignas(16) static constexpr std::uint8_t kPairs[16] = {0, 8, 4, 12, 1, 9, 5, 13, 2, 10, 6, 14, 3, 11, 7, 15};
  const auto pairs = hn::TableLookupBytes(v, hn::LoadDup128(d, kPairs));
  constexpr std::size_t kBlocks = hn::MaxLanes(d32) / 4;
  if constexpr (kBlocks <= 1) return pairs;
  alignas(64) std::uint32_t order[4 * kBlocks];
  for (std::size_t i = 0; i < 4 * kBlocks; ++i) order[i] = static_cast<std::uint32_t>(4 * (i % kBlocks) + i / kBlocks);
  const auto together = hn::TableLookupLanes(hn::BitCast(d32, pairs), hn::SetTableIndices(d32, order));
  alignas(16) static constexpr std::uint8_t kVectors[2][16] = {{0, 1, 4, 5, 2, 3, 6, 7, 8, 9, 12, 13, 10, 11, 14, 15},
                                                               {0, 1, 4, 5, 8, 9, 12, 13, 2, 3, 6, 7, 10, 11, 14, 15}};
  return hn::TableLookupBytes(hn::BitCast(d, together), hn::LoadDup128(d, kVectors[kBlocks / 4]));
}

/// Red or green of cells, on less off, limited to 0..255: of pair `lower` and pair `upper` of vectors.
template <Signal kSignal, bool kSubtract, class D>
HWY_INLINE auto colour_signals(D d, const std::uint8_t* on, const std::uint8_t* off, int lower, int upper) {
  const hn::RepartitionToWide<D> d16;
  const hn::RebindToSigned<decltype(d16)> di;
  const int pair = 2 * static_cast<int>(hn::Lanes(d));
  auto value = colours<kSignal>(d, on + lower * pair, on + upper * pair);
  if constexpr (kSubtract) value = hn::Sub(value, colours<kSignal>(d, off + lower * pair, off + upper * pair));
  return hn::BitCast(d16, hn::Min(hn::Max(value, hn::Zero(di)), hn::Set(di, 255)));
}

/// As many cells as D has lanes. (Not a lambda: those that are called twice may become functions, called for each
/// vector.)
template <Signal kSignal, bool kSubtract, class D>
HWY_INLINE void store_cells(D d, const std::uint8_t* on, const std::uint8_t* off, std::uint8_t* cells) {
  if constexpr (kSignal == Signal::grey || kSignal == Signal::yuyv_luma) {
    hn::StoreU(means_of_4<kSignal, kSubtract>(d, on, off), d, cells);
  } else {
    const auto even = colour_signals<kSignal, kSubtract>(d, on, off, 0, 2);
    const auto odd = colour_signals<kSignal, kSubtract>(d, on, off, 1, 3);
    hn::StoreU(pairs_in_order(d, hn::BitCast(d, hn::Or(even, hn::ShiftLeft<8>(odd)))), d, cells);
  }
}

/// One cell (mean signal) for each 4 pixels. @pre cell_count >= lanes of D
/// @param ask  called once an iteration, as by all loops over a row: asks memory for some of a later one
template <Signal kSignal, bool kSubtract, class D, class Ask>
HWY_INLINE void decimate(D d, const std::uint8_t* on, const std::uint8_t* off, int cell_count, std::uint8_t* cells,
                         Ask&& ask) {
  constexpr int kBytesPerCell = kSignal == Signal::grey ? 4 : 8;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto dark = [&](int cell) { return kSubtract ? off + cell * kBytesPerCell : nullptr; };
  int cell = 0;
  for (; cell + lanes <= cell_count; cell += lanes) {
    store_cells<kSignal, kSubtract>(d, on + cell * kBytesPerCell, dark(cell), cells + cell);
    ask();
  }
  if (cell == cell_count) return;
  cell = cell_count - lanes;  // no read or write beyond
  store_cells<kSignal, kSubtract>(d, on + cell * kBytesPerCell, dark(cell), cells + cell);
}

HWY_INLINE int largest(V8 v) {
  const hn::RepartitionToWide<D8> d;
  const auto pair = hn::BitCast(d, v);
  return hn::GetLane(hn::MaxOfLanes(d, hn::Max(hn::And(pair, hn::Set(d, 0xFF)), hn::ShiftRight<8>(pair))));
}

/// Repeats the first and the last cell beyond the ends. Some time before they are scored: a load that takes part of its
/// bytes from a store on its way to the cache waits for it.
/// @pre cells[-kPaddingCells .. cell_count + kPaddingCells) can be written
HWY_INLINE void pad_cells(std::uint8_t* cells, int cell_count) {
  const D8 d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  hn::StoreU(hn::Set(d, cells[0]), d, cells - lanes);
  const auto last = hn::Set(d, cells[cell_count - 1]);
  for (int i = 0; i < 3; ++i) hn::StoreU(last, d, cells + cell_count + i * lanes);
}

HWY_INLINE V8 mean_of_8_px(const std::uint8_t* cell) {
  const D8 d;
  return hn::AverageRound(hn::LoadU(d, cell), hn::LoadU(d, cell + 1));
}

/// Mean of 8 pixels less the larger of those 12 to the left and to the right: a line stands out, an edge or a gradient
/// does not.
HWY_INLINE V8 scores_of(const std::uint8_t* cell) {
  return hn::SaturatedSub(mean_of_8_px(cell), hn::Max(mean_of_8_px(cell - 3), mean_of_8_px(cell + 3)));
}

/// Scores all cells; returns the largest of each lane.
/// @pre padded cells; scores[-kPaddingCells .. cell_count + kPaddingCells) can be written
template <class Ask>
HWY_INLINE V8 score_cells(const std::uint8_t* cells, int cell_count, std::uint8_t* scores, Ask&& ask) {
  const D8 d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto zero = hn::Zero(d);
  auto highest = zero;
  int i = 0;
  for (; i < cell_count; i += 2 * lanes) {  // scores beyond the last cell are zero
    const auto even = scores_of(cells + i), odd = scores_of(cells + i + lanes);
    hn::Store(even, d, scores + i);
    hn::Store(odd, d, scores + i + lanes);
    highest = hn::Max(highest, hn::Max(even, odd));
    ask();
  }
  hn::Store(zero, d, scores - lanes);
  hn::Store(zero, d, scores + i);
  return highest;
}

/// A score and its neighbours, and the vertex of the parabola through them.
struct Vertex {
  int before = 0, score = 0, after = 0;

  float curvature() const { return static_cast<float>(HWY_MAX(2 * score - before - after, 1)); }
  float lean() const { return static_cast<float>(after - before); }
  float height() const { return static_cast<float>(score) + lean() * lean() / (8 * curvature()); }
  float offset_cells() const { return lean() / (2 * curvature()); }
};

HWY_INLINE Vertex vertex_at(const std::uint8_t* scores, int cell) {
  return {scores[cell - 1], scores[cell], scores[cell + 1]};
}

struct CoarsePeak {
  RowStatus status = RowStatus::no_line;
  int center_px = kWindowPx / 2;  ///< of status found or ambiguous, even
  int second_px = -1;             ///< of the second peak, if it could be the line
};

/// The even pixel nearest to 4 cell + 3.5, the middle of the 8 pixels, and the vertex's offset.
HWY_INLINE int center_of(int cell, const Vertex& vertex) {
  const int offset_px = 2 * (static_cast<int>(2 * vertex.offset_cells() + 16.25f) - 16);
  return 4 * cell + 4 + offset_px;
}

/// A second peak below this share of the first is no line that only looks fainter than its reflection.
inline constexpr float kSecondShare = 1.f / 3;

inline constexpr int kBlankCells = 6;  ///< on each side of a peak

HWY_INLINE int first_cell_of(const std::uint8_t* scores, int cell_count, int score) {
  const D8 d;
  const auto wanted = hn::Set(d, static_cast<std::uint8_t>(score));
  for (int i = 0; i < cell_count; i += static_cast<int>(hn::Lanes(d))) {
    const auto found = hn::FindFirstTrue(d, hn::Eq(hn::Load(d, scores + i), wanted));
    if (found >= 0) return i + static_cast<int>(found);
  }
  return 0;
}

/// Sets the scores about a peak to zero.
HWY_INLINE void blank(std::uint8_t* scores, int cell) {
  const hn::CappedTag<std::uint8_t, 16> d;
  std::uint8_t* at = scores + cell - kBlankCells;
  hn::StoreU(hn::IfThenZeroElse(hn::FirstN(d, 2 * kBlankCells + 1), hn::LoadU(d, at)), d, at);
}

/// Largest score and sum of the scores.
struct ScoreTotals {
  int highest = 0, sum = 0;
};

template <class Ask>
HWY_INLINE ScoreTotals totals_of(const std::uint8_t* scores, int cell_count, Ask&& ask) {
  const D8 d;
  const hn::Repartition<std::uint64_t, D8> d64;
  auto highest = hn::Zero(d);
  auto sum = hn::Zero(d64);
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int i = 0; i < cell_count; i += 2 * lanes) {
    const auto even = hn::Load(d, scores + i), odd = hn::Load(d, scores + i + lanes);
    highest = hn::Max(highest, hn::Max(even, odd));
    sum = hn::Add(sum, hn::Add(hn::SumsOf8(even), hn::SumsOf8(odd)));
    ask();
  }
  return {largest(highest), static_cast<int>(hn::GetLane(hn::SumOfLanes(d64, sum)))};
}

/// The largest score of a row.
struct TopScore {
  int cell = 0;  ///< the first that has it
  Vertex vertex;
};

/// Takes the top out of the scores. @pre highest >= every score of its lane, one of them equal
HWY_INLINE TopScore take_top(std::uint8_t* scores, int cell_count, V8 highest) {
  const int cell = first_cell_of(scores, cell_count, largest(highest));
  const TopScore top{cell, vertex_at(scores, cell)};
  blank(scores, cell);
  return top;
}

/// What the top that was taken out is, next to what is left: status found or ambiguous with centers, or no line.
template <class Ask>
HWY_INLINE CoarsePeak judge(const TopScore& top, const std::uint8_t* scores, int cell_count,
                            const LaserLineOptions& options, Ask&& ask) {
  const ScoreTotals left = totals_of(scores, cell_count, ask);
  if (top.vertex.score < options.minimum_contrast) return {};
  CoarsePeak peak{RowStatus::found, center_of(top.cell, top.vertex)};
  const float share = static_cast<float>(options.ambiguous_percent) * 0.01f;
  // A vertex is at most an eighth of its score higher than the score.
  if (static_cast<float>(left.highest) * 1.125f > HWY_MIN(share, kSecondShare) * static_cast<float>(top.vertex.score)) {
    const int cell = first_cell_of(scores, cell_count, left.highest);
    const Vertex second = vertex_at(scores, cell);
    if (second.height() > kSecondShare * top.vertex.height() && left.highest >= options.minimum_contrast) {
      peak.second_px = center_of(cell, second);
    }
    if (second.height() > share * top.vertex.height()) {
      peak.status = RowStatus::ambiguous;
      return peak;
    }
  }
  const int blanked = HWY_MIN(top.cell + kBlankCells, cell_count - 1) - HWY_MAX(top.cell - kBlankCells, 0) + 1;
  if (top.vertex.score * (cell_count - blanked) < kNoiseFactor * left.sum) return {};
  return peak;
}

}  // namespace HWY_NAMESPACE
}  // namespace celadon::line_kernels
HWY_AFTER_NAMESPACE();
#endif
