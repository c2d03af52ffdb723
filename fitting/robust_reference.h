#pragma once
// A fit that outliers and handles cannot move, from a bounded sample of the stream, and the verdict on every sample
// that follows from it. Source: README.md, "Weights".

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "fitting/moment_grid.h"
#include "fitting/profile.h"
#include "fitting/range_function.h"
#include "fitting/range_space.h"

namespace celadon {

/// The factor of Tukey's biweight at which normal errors keep 95 % of their efficiency.
inline constexpr double kTukey = 4.685;

/// First pass: add() every profile; then fit(); then verdict() on each sample of later passes.
class RobustReference {
 public:
  RobustReference(const MomentGrid& sums, int degree_u, int degree_v, JointContinuity continuity);

  /// v of the profile's samples; samples outside the grid's band, not finite or with r <= 0 are passed over.
  void add(const Profile& profile, const double* v);
  /// False: the sample determines no surface.
  bool fit();

  const RangeFunction& function() const { return function_; }
  /// Robust standard deviation of the residuals, mm.
  double scale_mm() const { return scale_; }
  /// Some samples of the reservoir do not belong to the surface: weights are needed.
  bool found_strangers() const { return strangers_; }

  enum class Kind : std::uint8_t { good, outlier, unfollowable };
  struct Verdict {
    double weight = 1;  ///< Tukey's, 0 unless good
    Kind kind = Kind::good;
  };
  /// Of a sample at (v, z) with range r whose residual to function() is given.
  Verdict verdict(double v, double z_mm, double r_mm, double residual_mm) const;

  /// 95th percentile of |r - F| of another function over the accepted samples: without a pass.
  double percentile95(const RangeFunction& function) const;

 private:
  struct Point {
    double r, v, z, theta;
  };
  // Samples of a cell whose ranges follow on one another without a gap.
  struct Cluster {
    double low, high, median;
    int first, count;  // in the cell's points, sorted by range
    bool significant = false, accepted = false, steep = false;
  };
  struct Cell {
    std::vector<Point> points;
    std::size_t seen = 0;
    std::vector<Cluster> clusters;
    double middle = 0, limit = 0;  // local scale of accepted residuals; 0 unknown
    const Cluster* accepted() const;
  };
  static constexpr std::size_t kPerCell = 32;

  int index_of(double v, double z_mm) const;
  double diagonal(double r) const;
  void split(Cell& cell) const;
  void choose_body();
  void choose_single_values();
  void update_limits();
  bool solve(bool weighted);

  GridSpecification specification_;
  JointContinuity continuity_;
  BaseArcs arcs_;
  int cells_z_ = 1, cells_v_ = 1;
  double cell_height_ = 1;
  std::vector<Cell> cells_;
  RangeFunction function_;
  double scale_ = 0;
  bool strangers_ = false;
};

}  // namespace celadon
