#pragma once
// A grid's sums over its own cells or over larger ones, each the union of some of them. Source: README.md,
// "Restriction".

#include <cstddef>
#include <span>
#include <vector>

#include "fitting/aligned_allocator.h"
#include "fitting/assembly_kernels.h"
#include "fitting/moment_grid.h"
#include "fitting/moment_layout.h"

namespace celadon {

/// Cells with their sums, which belong to someone else. Cell (i, j) covers [edges_z[i], edges_z[i + 1]) along z and
/// [edges_v[j], edges_v[j + 1]) around, in cells of the grid.
struct MomentCells {
  MomentLayout layout;
  std::vector<int> edges_z, edges_v;
  const double* sums = nullptr;

  int count_z() const { return static_cast<int>(edges_z.size()) - 1; }
  int count_v() const { return static_cast<int>(edges_v.size()) - 1; }
  const double* cell(int i, int j) const {
    return sums + static_cast<std::ptrdiff_t>(j * count_z() + i) * layout.stride();
  }
};

/// A grid's own cells. @pre the grid outlives them
MomentCells cells_of(const MomentGrid& grid);

/// How cells lie in larger intervals of one direction.
struct CellMap {
  std::vector<int> first, last;                        ///< cells [first, last) of each interval
  std::vector<assembly_kernels::Placement> placement;  ///< of each cell in its interval
};
/// @throws std::invalid_argument naming `direction` if the ends of the intervals are not ascending edges of the cells
CellMap map_cells(std::span<const int> cell_edges, std::span<const int> interval_edges, const char* direction);

/// The sums of larger cells from those of smaller ones, moved by the binomial theorem.
class MergedMoments {
 public:
  /// @throws std::invalid_argument if an edge is not among those of the finer cells
  MergedMoments(const MomentCells& finer, std::vector<int> edges_z, std::vector<int> edges_v);
  /// @pre this object outlives them
  MomentCells cells() const { return {layout_, edges_z_, edges_v_, sums_.data()}; }

 private:
  MomentLayout layout_;
  std::vector<int> edges_z_, edges_v_;
  AlignedVector<double> sums_;
};

}  // namespace celadon
