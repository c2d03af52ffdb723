#pragma once
// The dyadic ladder of spaces nested in a moment grid. Source: README.md, "Restriction".

#include <map>
#include <utility>
#include <vector>

#include "fitting/moment_cells.h"
#include "fitting/moment_grid.h"
#include "fitting/normal_solver.h"
#include "fitting/range_space.h"

namespace celadon {

/// z cells [first, last) of a grid; on a sphere its ends may be closed poles.
struct CellBand {
  int first = 0, last = 0;
  Poles poles{};
};

/// Which directions a range function varies in.
struct Variation {
  bool along_u = true, around_v = true;
};

/// Spaces over a band of a grid's z cells; level 0 is the grid itself, each level halves the intervals of a direction.
/// Every space of a higher level lies in those of lower levels, and constants in all of them. The sums of coarser cells
/// are merged when first asked for and kept: the grid must not change meanwhile, and one thread at a time may ask.
class FitLadder {
 public:
  FitLadder(const MomentGrid& sums, CellBand band, int degree_u, int degree_v, JointContinuity continuity);

  int levels_u() const { return levels_u_; }
  int levels_v() const { return levels_v_; }
  FitSpace space(int level_u, int level_v, Variation variation = {}) const;
  /// The equations of that space, from the coarsest cells kept.
  NormalEquations equations(int level_u, int level_v, Variation variation = {}) const;
  /// Unknowns without building the space.
  int unknowns(int level_u, int level_v, Variation variation = {}) const;
  int intervals_u(int level_u) const { return static_cast<int>(edges(level_u).size()) - 1; }
  int intervals_per_arc(int level_v) const { return sums_.specification().intervals_per_arc >> level_v; }
  CellBand band() const { return band_; }
  const MomentGrid& sums() const { return sums_; }

 private:
  std::vector<int> edges(int level_u) const;
  int joint_cell() const;
  bool merges(int level_u, int level_v) const;
  MomentCells cells(int level_u, int level_v) const;
  const MomentGrid& sums_;
  CellBand band_;
  int degree_u_, degree_v_, levels_u_ = 1, levels_v_ = 1;
  JointContinuity continuity_;
  mutable std::map<std::pair<int, int>, MergedMoments> merged_;
};

}  // namespace celadon
