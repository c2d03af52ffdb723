#pragma once
// A bounded, even sample of a stream of range data in coarse cells over (z, v): what the robust start looks at.
// Source: README.md, "Outliers" and "Handles".

#include <cstddef>
#include <vector>

#include "fitting/first_look.h"
#include "fitting/moment_grid.h"

namespace celadon {

/// `key` orders the samples of a cell: their range, or later what a surface leaves of it.
struct CellPoint : SamplePoint {
  double key;
};

/// Samples of a cell that follow on one another without a gap.
struct Cluster {
  int first = 0, count = 0;              ///< in the cell's points
  double low = 0, high = 0, median = 0;  ///< of the ranges, mm
  double v_low = 0, v_high = 0, z_low = 0, z_high = 0;
  bool significant = false;  ///< not a few strays
  bool accepted = false;     ///< of the surface that is fitted
  double handle_mm = 0;      ///< > 0: of a sheet over the body, or one that protrudes so far
};

struct SampleCell {
  std::vector<CellPoint> points;  ///< those of the clusters in order, then strays
  std::size_t kept = 0;           ///< points that are no strays
  std::size_t seen = 0;           ///< samples that fell into the cell, kept or not
  std::vector<Cluster> clusters;
  const Cluster* accepted() const;  ///< the first accepted one; nullptr: none
};

/// Cells about as high as wide, column by column around. At most 32 samples are kept of each. Empty columns follow on
/// the last of an open range: its ends are no neighbours.
class SampleCells {
 public:
  static constexpr std::size_t kPerCell = 32;
  /// @pre the samples lie in the sums' band
  SampleCells(const MomentGrid& sums, const std::vector<SamplePoint>& samples);

  int along() const { return cells_z_; }
  int around() const { return cells_v_; }
  int columns_with_samples() const { return cells_v_ - gap_; }  ///< all but those behind an open range
  std::size_t size() const { return cells_.size(); }
  std::size_t index(int i, int j) const {
    return static_cast<std::size_t>(j) * static_cast<std::size_t>(cells_z_) + static_cast<std::size_t>(i);
  }
  /// The column j steps around, modulo the turn.
  int column(int j) const { return (j % cells_v_ + cells_v_) % cells_v_; }
  std::size_t index_of(double v, double z_mm) const;
  /// Calls with the index of each of the up to nine cells around a cell, itself among them.
  template <class Visit>
  void visit_neighbourhood(std::size_t k, const Visit& visit) const {
    const int i = static_cast<int>(k) % cells_z_, j = static_cast<int>(k) / cells_z_;
    for (int dj = -1; dj <= 1; ++dj)
      for (int di = -1; di <= 1; ++di)
        if (i + di >= 0 && i + di < cells_z_) visit(index(i + di, column(j + dj)));
  }
  SampleCell& operator[](std::size_t k) { return cells_[k]; }
  const SampleCell& operator[](std::size_t k) const { return cells_[k]; }
  auto begin() { return cells_.begin(); }
  auto end() { return cells_.end(); }
  auto begin() const { return cells_.begin(); }
  auto end() const { return cells_.end(); }

  /// In the sums' coordinate along the base.
  double height() const { return cell_height_; }
  double width_mm(double r_mm) const;
  double diagonal_mm(double r_mm) const;
  /// v of all columns together, and the angle of a unit of v.
  double turn_v() const { return turn_v_; }
  double arc_rad() const { return arc_rad_; }

 private:
  void keep(const SamplePoint& sample);
  bool spherical_;
  double z_start_, z_end_, turn_v_, arc_rad_, cell_height_ = 1;
  int cells_z_ = 1, cells_v_ = 1, gap_ = 0;
  std::vector<SampleCell> cells_;
};

}  // namespace celadon
