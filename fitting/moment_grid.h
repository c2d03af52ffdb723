#pragma once
// Streamed sums of a range fit: polynomial moments per cell of a dyadic grid over (z, v), from which the normal
// equations of every space nested in the grid follow exactly. Memory does not depend on the number of samples. Source:
// README.md, "Accumulation".

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "fitting/aligned_allocator.h"
#include "fitting/base_surface.h"
#include "fitting/moment_layout.h"
#include "fitting/profile.h"

namespace celadon {

/// What two sets of sums must agree on to be merged.
struct GridSpecification {
  double z_start_mm = 0, z_end_mm = 0;      ///< band of the grid, z_start < z_end
  int z_intervals = 32;                     ///< a power of two, uniform over the band
  int intervals_per_arc = 32;               ///< a power of two, uniform in v on each arc
  int degree_u = 3, degree_v = 3;           ///< the largest degrees that can be solved for, 1..5
  BaseArcs arcs = BaseArcs::full_circle();  ///< the whole turn, or the open range that samples are taken from
  /// Over a sphere, samples are (rho, theta, w) in place of (r, theta, z), w the meridian's parameter (base_surface.h),
  /// and the band is [0, 2].
  BaseKind base = BaseKind::cylinder;
  bool operator==(const GridSpecification&) const = default;
};

/// Weights of samples: 1/w^2 = sigma_r^2 + (r_z sigma_z)^2 + (r_theta sigma_theta)^2 with cross terms.
enum class WeightRule : std::uint8_t { unit, covariance };

class MomentGrid {
 public:
  /// @throws std::invalid_argument for an empty or not finite band, numbers of intervals that are no powers of two, or
  /// degrees outside 1..5
  explicit MomentGrid(const GridSpecification& specification, WeightRule rule = WeightRule::unit);

  const GridSpecification& specification() const { return specification_; }
  WeightRule rule() const { return rule_; }

  /// Add a profile in general position (each sample its own theta, optional weights of length n; empty = 1).
  /// Samples outside the band, with r <= 0 or not finite are counted as rejected, never added.
  void add(std::span<const double> r_mm, std::span<const double> theta_rad, std::span<const double> z_mm,
           std::span<const double> weight = {});
  /// The same with v as BaseArcs::place() gives it in place of theta.
  void add_synchronised(std::span<const double> r_mm, std::span<const double> v, std::span<const double> z_mm,
                        std::span<const double> weight = {});
  /// Add a profile whose samples share one theta, z ascending or not: one-dimensional sums, one outer product a cell.
  void add_constant_theta(double theta_rad, std::span<const double> r_mm, std::span<const double> z_mm);
  /// Add points x, y, z (axis = z).
  void add_cartesian(std::span<const double> x_mm, std::span<const double> y_mm, std::span<const double> z_mm);
  /// Add a complete regular grid: r_mm(i, j) at theta_i = 2 pi (i + offset)/rows and the given z_j.
  void add_regular(const Eigen::Ref<const Eigen::Matrix<double, -1, -1, Eigen::RowMajor>>& r_mm,
                   double theta_offset_rad, std::span<const double> z_mm);

  /// Sums of another grid with the same specification and rule. @throws std::invalid_argument naming what differs
  void merge(const MomentGrid& other);

  /// Numbers of samples, and of those that were left out.
  struct Counts {
    std::size_t samples = 0, on_axis = 0, not_finite = 0, outside = 0;
  };
  /// Adds what pack() gave of the cells of another grid, and its counts.
  void add_packed(int z_cell, int v_cell, const double* packed);
  void add_counts(const Counts& counts);
  /// The sums of one cell without what the layout adds: W_ba (b = 0..2p, a = 0..2q running fastest), R_ba (to p and q)
  /// and sum w r^2. @pre packed has packed_size() numbers
  void pack(int z_cell, int v_cell, double* packed) const;
  std::size_t packed_size() const;
  Counts counts() const { return {samples_, rejected_on_axis_, rejected_not_finite_, rejected_outside_}; }

  /// All weights times a factor.
  void scale(double factor);

  std::size_t samples() const { return samples_; }
  std::size_t rejected() const { return rejected_on_axis_ + rejected_not_finite_ + rejected_outside_; }
  std::size_t rejected_on_axis() const { return rejected_on_axis_; }        ///< r <= 0
  std::size_t rejected_not_finite() const { return rejected_not_finite_; }  ///< a NaN, an infinity or a weight <= 0
  std::size_t rejected_outside() const { return rejected_outside_; }        ///< z outside the band, theta the range
  double sum_weight() const;
  double sum_weighted_range() const;
  double sum_weighted_square() const;
  std::size_t memory_bytes() const;

  const BaseArcs& arcs() const { return specification_.arcs; }
  int z_cells() const { return specification_.z_intervals; }
  int v_cells() const { return arcs().count() * specification_.intervals_per_arc; }
  /// Lower edge of a z cell; edge z_cells() is the end of the band.
  double z_edge_mm(int z_cell) const;
  const MomentLayout& layout() const { return layout_; }
  /// The sums of one cell, laid out as layout() says.
  const double* cell(int z_cell, int v_cell) const {
    return cells_.data() +
           static_cast<std::size_t>(v_cell * z_cells() + z_cell) * static_cast<std::size_t>(layout_.stride());
  }
  /// Sum of the weights in one cell (the number of samples when they are 1).
  double cell_weight(int z_cell, int v_cell) const { return cell(z_cell, v_cell)[0]; }

 private:
  void count_rejected(std::span<const double> r_mm, std::span<const double> v, std::span<const double> z_mm,
                      std::span<const double> weight);
  GridSpecification specification_;
  WeightRule rule_;
  MomentLayout layout_;
  AlignedVector<double> cells_;
  std::size_t samples_ = 0, rejected_on_axis_ = 0, rejected_not_finite_ = 0, rejected_outside_ = 0;
};

}  // namespace celadon
