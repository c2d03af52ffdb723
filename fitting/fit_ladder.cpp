#include "fitting/fit_ladder.h"

#include <algorithm>
#include <bit>

namespace celadon {

FitLadder::FitLadder(const MomentGrid& sums, CellBand band, int degree_u, int degree_v, JointContinuity continuity)
    : sums_(sums), band_(band), degree_u_(degree_u), degree_v_(degree_v), continuity_(continuity) {
  // A closed pole keeps two intervals between itself and the joint, or the other end.
  const int joint = joint_cell();
  int shortest = band.last - band.first;
  if (band.poles.start) shortest = std::min(shortest, ((joint > 0 ? joint : band.last) - band.first) / 2);
  if (band.poles.end) shortest = std::min(shortest, (band.last - (joint > 0 ? joint : band.first)) / 2);
  while ((1 << levels_u_) <= shortest) ++levels_u_;
  levels_v_ = std::countr_zero(static_cast<unsigned>(sums.specification().intervals_per_arc)) + 1;
}

// The edge at the joint of a sphere's meridian; 0: it is not inside the band.
int FitLadder::joint_cell() const {
  const auto& grid = sums_.specification();
  if (grid.base != BaseKind::sphere) return 0;
  const int joint = grid.z_intervals / 2;
  return joint > band_.first && joint < band_.last ? joint : 0;
}

// The ends of the band, the joint, and the level's uniform edges between them that are at least half an interval away
// from both: no interval at a rim is shorter than half of the others, and dropping edges keeps the levels nested.
std::vector<int> FitLadder::edges(int level_u) const {
  const int step = 1 << level_u;
  std::vector<int> result{band_.first};
  for (int edge = (band_.first / step + 1) * step; edge < band_.last; edge += step)
    if (2 * (edge - band_.first) >= step && 2 * (band_.last - edge) >= step) result.push_back(edge);
  if (const int joint = joint_cell(); joint > 0 && !std::binary_search(result.begin(), result.end(), joint))
    result.insert(std::lower_bound(result.begin(), result.end(), joint), joint);
  result.push_back(band_.last);
  return result;
}

FitSpace FitLadder::space(int level_u, int level_v, Variation variation) const {
  std::vector<double> breaks;
  for (const int edge : edges(level_u)) breaks.push_back(sums_.z_edge_mm(edge));
  const std::vector<double> ends{breaks.front(), breaks.back()};
  const std::vector<double> circle{0.0, static_cast<double>(sums_.arcs().count())};
  const bool spherical = sums_.specification().base == BaseKind::sphere;
  const auto along = [&] {
    if (!variation.along_u) return RangeSpace::constant(ends);
    return spherical ? RangeSpace::over(degree_u_, BaseSurface::meridian(), std::move(breaks), continuity_)
                     : RangeSpace::open(degree_u_, std::move(breaks));
  };
  return {along(),
          variation.around_v ? RangeSpace::over(degree_v_, sums_.arcs(), intervals_per_arc(level_v), continuity_)
                             : RangeSpace::constant(circle),
          variation.along_u ? band_.poles : Poles{}};
}

// Levels that are coarser in every direction there is to coarsen: together they have fewer cells than the grid. The
// others read the grid itself.
bool FitLadder::merges(int level_u, int level_v) const {
  return (level_u > 0 || levels_u_ == 1) && (level_v > 0 || levels_v_ == 1) && level_u + level_v > 0;
}

MomentCells FitLadder::cells(int level_u, int level_v) const {
  if (!merges(level_u, level_v)) return cells_of(sums_);
  const auto kept = merged_.find({level_u, level_v});
  if (kept != merged_.end()) return kept->second.cells();
  // From one level finer in both directions, or in the one that has a finer level of this kind, or from the grid.
  std::pair<int, int> finer{0, 0};
  for (const auto& at :
       {std::pair{level_u, level_v - 1}, std::pair{level_u - 1, level_v}, std::pair{level_u - 1, level_v - 1}})
    if (at.first >= 0 && at.second >= 0 && merges(at.first, at.second)) finer = at;
  std::vector<int> edges_v;
  for (int edge = 0; edge <= sums_.v_cells(); edge += 1 << level_v) edges_v.push_back(edge);
  const auto entry =
      merged_.try_emplace({level_u, level_v}, cells(finer.first, finer.second), edges(level_u), std::move(edges_v));
  return entry.first->second.cells();
}

NormalEquations FitLadder::equations(int level_u, int level_v, Variation variation) const {
  return {sums_, cells(variation.along_u ? level_u : levels_u_ - 1, variation.around_v ? level_v : levels_v_ - 1),
          space(level_u, level_v, variation)};
}

int FitLadder::unknowns(int level_u, int level_v, Variation variation) const {
  const int arcs = sums_.arcs().count(), intervals = arcs * intervals_per_arc(level_v);
  const bool plain = degree_v_ <= 2 || continuity_ == JointContinuity::thesis, closed = sums_.arcs().periodic();
  const int at_joints = plain ? 0 : (closed ? arcs : arcs - 1) * (degree_v_ - 3);
  int v = intervals + at_joints + (closed ? 0 : degree_v_);
  if (sums_.arcs().ends() == ArcEnds::mirrored && degree_v_ > 1) v = std::max(1, v - 2);
  const int around = variation.around_v ? v : 1;
  if (!variation.along_u) return around;
  const bool joint = joint_cell() > 0 && degree_u_ >= 3 && continuity_ == JointContinuity::curvature;
  int rows = intervals_u(level_u) + degree_u_ + (joint ? degree_u_ - 3 : 0), jets = 0;
  for (const bool pole : {band_.poles.start, band_.poles.end})
    if (pole) {
      rows -= band_.poles.rows(degree_u_);
      jets += degree_u_ == 1 || band_.poles.rule == PoleRule::level ? 1 : std::min(6, 2 + 2 * (around - 1));
    }
  return rows * around + jets;
}

}  // namespace celadon
