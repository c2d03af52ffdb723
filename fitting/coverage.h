#pragma once
// Where a grid has samples: the band covered all around, and the share of it that is covered.
// Source: README.md, "Rims".

#include <array>
#include <vector>

#include "fitting/fit_ladder.h"
#include "fitting/moment_grid.h"

namespace celadon {

/// Smallest and largest z of the samples of each (z cell, sector), from a pass over them.
class SectorExtents {
 public:
  static constexpr int kSectors = 16;
  explicit SectorExtents(const MomentGrid& sums);
  /// v in [0, arcs), z inside the grid's band.
  void add(double v, double z_mm);
  /// Those of both. @pre of the same sums
  void merge(const SectorExtents& other);
  /// Of one place; infinities with the wrong sign where there are no samples.
  void set(int z_cell, int sector, double lowest, double highest) {
    lowest_[index(z_cell, sector)] = lowest;
    highest_[index(z_cell, sector)] = highest;
  }
  double lowest(int z_cell, int sector) const { return lowest_[index(z_cell, sector)]; }
  double highest(int z_cell, int sector) const { return highest_[index(z_cell, sector)]; }

 private:
  std::size_t index(int z_cell, int sector) const { return static_cast<std::size_t>(z_cell * kSectors + sector); }
  double z_start_, z_scale_, v_scale_;
  int z_cells_;
  std::vector<double> lowest_, highest_;
};

struct CoveredBand {
  CellBand cells;  ///< empty: no height is covered in every sector that has samples
  double z_start_mm = 0, z_end_mm = 0;
  double lowest_mm = 0, highest_mm = 0;  ///< of all samples that count
  int sectors = 0, sectors_with_samples = 0;
  BaseKind base = BaseKind::cylinder;
};

/// The band in which every sector that is not empty as a whole has samples; its ends to the sample if extents are
/// given, else from the first moments in the end cells.
CoveredBand find_covered_band(const MomentGrid& sums, const SectorExtents* extents);

/// Share of the band's area with samples, judged in cells that would hold about ten of them each if even.
double covered_share(const MomentGrid& sums, const CoveredBand& band);

}  // namespace celadon
