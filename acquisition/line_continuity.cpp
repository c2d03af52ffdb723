// README.md, "Line extraction", step 6.
#include "acquisition/line_continuity.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace celadon {
namespace {

constexpr int kEvidenceRows = 6;  ///< fewer are no evidence
constexpr int kBridgedRows = 32;  ///< a strand goes on beyond a shorter one
constexpr int kYoungGapRows = 4;  ///< ends a strand that has only begun
constexpr std::size_t kEvidenceReachRows =
    64;  ///< before the first row with two peaks and after the last: enough for evidence
/// Coarse peaks are even pixels, moved by noise and speckle. Two peaks of a row are 28 px apart at least.
constexpr float kGate_px = 6, kWidestGate_px = 14;
constexpr float kGateGrowth_px = 0.25f;  ///< a row of gap
constexpr float kSteepestStart_px = 2;   ///< a row, of a strand whose slope is not known yet
constexpr int kSlopeMemory_rows = 8;
/// Nearer to each other than this, two strands may have become one peak: how they go on tells nothing of either.
constexpr int kMergingPx = 48;
constexpr int kPrevious_px = 10;  ///< from a frame to the next a line moves less

/// Peaks of successive rows that follow each other: a line, a reflection, an edge of the texture.
struct Strand {
  int first_row = 0, last_row = 0, rows = 0;
  float x_px = 0, slope = 0;                ///< at last_row; pixels a row
  int first_shared = -1, last_shared = -1;  ///< rows in which another strand has a peak too
  bool merges_before = false, merges_after = false;
  int alone_before = 0, alone_after = 0;  ///< rows of its own before first_shared and after last_shared

  /// How far a peak in `row` is from where the strand leads; beyond any gate if it is no continuation.
  float miss_px(int row, int px) const {
    const auto gap = static_cast<float>(row - last_row);
    const bool young = rows < kEvidenceRows;
    const float gate =
        young ? kGate_px + kSteepestStart_px * gap : kGate_px + kGateGrowth_px * gap + 0.5f * std::abs(slope);
    const float miss = std::abs(static_cast<float>(px) - x_px - slope * gap);
    return miss <= std::min(gate, kWidestGate_px) ? miss : kNever;
  }
  bool ended(int row) const { return row - last_row > (rows < kEvidenceRows ? kYoungGapRows : kBridgedRows); }
  void take(int row, int px) {
    const int gap = row - last_row;
    const float change = static_cast<float>(px) - x_px;
    const float shown = gap == 1 ? change : change / static_cast<float>(gap);
    slope += (shown - slope) * (rows < kSlopeMemory_rows ? 1 / static_cast<float>(rows) : 1.f / kSlopeMemory_rows);
    x_px = static_cast<float>(px);
    last_row = row;
    ++rows;
  }
  bool evident() const {
    return (!merges_before && alone_before >= kEvidenceRows) || (!merges_after && alone_after >= kEvidenceRows);
  }
  bool nowhere_alone() const { return (merges_before || alone_before <= 1) && (merges_after || alone_after <= 1); }

  static constexpr float kNever = 1e9f;
};

constexpr int kNoStrand = -1;
using RowStrands = std::array<int, 2>;  ///< of the first and the second peak; kNoStrand

int peak_of(const PeakPair& pair, int which) {
  return which == 0 ? pair.first_px : pair.second_px;
}

/// Two strands that have rows in common.
struct Rivals {
  int a = kNoStrand, b = kNoStrand;  ///< a < b
  int first_row = 0, last_row = 0;   ///< that they have in common
  int rows = 0, a_brighter = 0;
  int a_as_before = 0, b_as_before = 0;  ///< rows in which only a (b) lies where the line of the frame before lay
  int winner = kNoStrand;

  bool hold(int strand) const { return a == strand || b == strand; }
  /// Now one is brighter, now the other: brightness tells nothing.
  bool undecidable() const {
    return winner == kNoStrand && a_brighter >= kEvidenceRows && rows - a_brighter >= kEvidenceRows;
  }
};

/// Joins peaks row by row: each to the strand that it misses least.
class Strands {
 public:
  explicit Strands(std::span<const PeakPair> peaks) : of_row_(peaks.size(), RowStrands{kNoStrand, kNoStrand}) {
    for (std::size_t row = 0; row < peaks.size(); ++row) add(static_cast<int>(row), peaks[row]);
    for (RowStrands& row : of_row_) {
      for (int& strand : row) {
        if (strand != kNoStrand && strands_[static_cast<std::size_t>(strand)].rows < kEvidenceRows) strand = kNoStrand;
      }
    }
    find_evidence(peaks);
  }

  const RowStrands& of_row(std::size_t row) const { return of_row_[row]; }
  const Strand& operator[](int strand) const { return strands_[static_cast<std::size_t>(strand)]; }

 private:
  void add(int row, const PeakPair& pair) {
    if (pair.first_px < 0) return;
    RowStrands& mine = of_row_[static_cast<std::size_t>(row)];
    std::array<float, 2> miss{Strand::kNever, Strand::kNever};
    for (std::size_t i = active_.size(); i-- > 0;) {
      const int s = active_[i];
      const Strand& strand = strands_[static_cast<std::size_t>(s)];
      if (strand.ended(row)) {
        active_.erase(active_.begin() + static_cast<std::ptrdiff_t>(i));
        continue;
      }
      for (int which = 0; which < 2 && peak_of(pair, which) >= 0; ++which) {
        const auto w = static_cast<std::size_t>(which);
        const float m = strand.miss_px(row, peak_of(pair, which));
        if (m < miss[w]) miss[w] = m, mine[w] = s;
      }
    }
    if (mine[0] != kNoStrand && mine[0] == mine[1]) mine[miss[0] <= miss[1] ? 1 : 0] = kNoStrand;
    for (int which = 0; which < 2 && peak_of(pair, which) >= 0; ++which) {
      int& strand = mine[static_cast<std::size_t>(which)];
      const int px = peak_of(pair, which);
      if (strand != kNoStrand) {
        strands_[static_cast<std::size_t>(strand)].take(row, px);
      } else {
        strand = static_cast<int>(strands_.size());
        strands_.push_back({.first_row = row, .last_row = row, .rows = 1, .x_px = static_cast<float>(px)});
        active_.push_back(strand);
      }
    }
  }

  void find_evidence(std::span<const PeakPair> peaks) {
    for (std::size_t row = 0; row < of_row_.size(); ++row) {
      if (of_row_[row][0] == kNoStrand || of_row_[row][1] == kNoStrand) continue;
      const bool merging = std::abs(peaks[row].first_px - peaks[row].second_px) < kMergingPx;
      for (const int s : of_row_[row]) {
        Strand& strand = strands_[static_cast<std::size_t>(s)];
        if (strand.first_shared < 0) {
          strand.first_shared = static_cast<int>(row);
          strand.merges_before = merging;
        }
        strand.last_shared = static_cast<int>(row);
        strand.merges_after = merging;
      }
    }
    for (std::size_t row = 0; row < of_row_.size(); ++row) {
      const auto [first, second] = of_row_[row];
      if ((first == kNoStrand) == (second == kNoStrand)) continue;
      Strand& strand = strands_[static_cast<std::size_t>(first != kNoStrand ? first : second)];
      if (strand.first_shared < 0) continue;
      strand.alone_before += static_cast<int>(row) < strand.first_shared;
      strand.alone_after += static_cast<int>(row) > strand.last_shared;
    }
  }

  std::vector<Strand> strands_;
  std::vector<RowStrands> of_row_;
  std::vector<int> active_;
};

bool is_placed(const LineRow& row) {
  return row.status == RowStatus::found || row.status == RowStatus::saturated;
}

Rivals& rivals_of(std::vector<Rivals>& all, const RowStrands& strands) {
  const auto [a, b] = std::minmax(strands[0], strands[1]);
  const auto at =
      std::find_if(all.rbegin(), all.rend(), [a = a, b = b](const Rivals& r) { return r.a == a && r.b == b; });
  if (at != all.rend()) return *at;
  all.push_back({.a = a, .b = b});
  return all.back();
}

/// The strand that goes on alone beside one that does not; without such evidence, or against it, where the line lay in
/// the frame before.
int winner_of(const Rivals& rivals, const Strands& strands) {
  const Strand &a = strands[rivals.a], &b = strands[rivals.b];
  const auto lay_there = [&](int mine, int other) {
    return mine >= kEvidenceRows && 2 * mine >= rivals.rows && 10 * other <= mine;
  };
  const bool a_before = lay_there(rivals.a_as_before, rivals.b_as_before),
             b_before = lay_there(rivals.b_as_before, rivals.a_as_before);
  if (a.evident() && b.nowhere_alone()) return b_before ? kNoStrand : rivals.a;
  if (b.evident() && a.nowhere_alone()) return a_before ? kNoStrand : rivals.b;
  return a_before ? rivals.a : b_before ? rivals.b : kNoStrand;
}

std::vector<Rivals> judged_rivals(std::span<const PeakPair> peaks, std::span<const LineRow> previous,
                                  const Strands& strands) {
  std::vector<Rivals> all;
  for (std::size_t row = 0; row < peaks.size(); ++row) {
    const RowStrands& mine = strands.of_row(row);
    if (mine[0] == kNoStrand || mine[1] == kNoStrand) continue;
    Rivals& rivals = rivals_of(all, mine);
    if (rivals.rows++ == 0) rivals.first_row = static_cast<int>(row);
    rivals.last_row = static_cast<int>(row);
    const std::size_t a = mine[0] == rivals.a ? 0 : 1;
    rivals.a_brighter += a == 0;
    if (previous.empty() || !is_placed(previous[row])) continue;
    const auto as_before = [&](std::size_t which) {
      return std::abs(static_cast<float>(peak_of(peaks[row], static_cast<int>(which))) - previous[row].x_px) <=
             kPrevious_px;
    };
    rivals.a_as_before += as_before(a);
    rivals.b_as_before += as_before(1 - a);
  }
  for (Rivals& rivals : all) rivals.winner = winner_of(rivals, strands);
  return all;
}

}  // namespace

void choose_peaks(std::span<const PeakPair> peaks, std::span<const LineRow> rows, std::span<const LineRow> previous,
                  std::vector<PeakChoice>& choices) {
  choices.clear();
  const auto is_pair = [](const PeakPair& p) { return p.second_px >= 0; };
  const auto first_pair = std::find_if(peaks.begin(), peaks.end(), is_pair);
  if (std::count_if(first_pair, peaks.end(), is_pair) < kEvidenceRows) return;
  const auto last_pair = std::find_if(peaks.rbegin(), peaks.rend(), is_pair).base();
  const auto before = static_cast<std::size_t>(first_pair - peaks.begin());
  const std::size_t begin = before - std::min(before, kEvidenceReachRows);
  const std::size_t count =
      std::min(static_cast<std::size_t>(last_pair - peaks.begin()) + kEvidenceReachRows, peaks.size()) - begin;
  peaks = peaks.subspan(begin, count);
  rows = rows.subspan(begin, count);
  if (!previous.empty()) previous = previous.subspan(begin, count);
  const Strands strands(peaks);
  std::vector<Rivals> all = judged_rivals(peaks, previous, strands);
  // A strand that is alone in a row: a reflection whose line is hidden there, or one of two that nobody can tell apart.
  const auto doubtful = [&](int strand, int row) {
    return std::any_of(all.begin(), all.end(), [&](const Rivals& r) {
      if (!r.hold(strand) || r.rows < kEvidenceRows) return false;
      if (r.winner != kNoStrand) return r.winner != strand;
      return r.undecidable() && row >= r.first_row && row <= r.last_row;
    });
  };
  for (std::size_t row = 0; row < peaks.size(); ++row) {
    const auto [first, second] = strands.of_row(row);
    const int number = static_cast<int>(row);
    const bool placed = is_placed(rows[row]);
    if (first == kNoStrand) continue;
    const int frame_row = static_cast<int>(begin + row);
    if (second == kNoStrand) {
      if (placed && doubtful(first, number)) choices.push_back({frame_row});
      continue;
    }
    const Rivals& rivals = rivals_of(all, strands.of_row(row));
    if (rivals.winner == second || (rivals.winner == first && rows[row].status == RowStatus::ambiguous)) {
      choices.push_back({frame_row, peak_of(peaks[row], rivals.winner == first ? 0 : 1)});
    } else if (placed && rivals.undecidable()) {
      choices.push_back({frame_row});
    }
  }
}

}  // namespace celadon
