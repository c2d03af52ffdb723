#pragma once
// A fit that outliers and handles cannot move, from a bounded sample of the stream, and the verdict on every sample
// that follows from it. Source: README.md, "Weights".

#include <cstdint>
#include <initializer_list>
#include <optional>
#include <vector>

#include "fitting/cell_polynomials.h"
#include "fitting/executor.h"
#include "fitting/first_look.h"
#include "fitting/moment_grid.h"
#include "fitting/range_function.h"
#include "fitting/range_space.h"
#include "fitting/sample_cells.h"

namespace celadon {

/// The factor of Tukey's biweight at which normal errors keep 95 % of their efficiency.
inline constexpr double kTukey = 4.685;

/// Built and fit() after the first look; then verdict() on each sample of later passes.
class RobustReference {
 public:
  RobustReference(const MomentGrid& sums, const FirstLook& look, int degree_u, int degree_v, JointContinuity continuity,
                  Executor executor = run_in_turn);

  /// False: the sample determines no surface.
  bool fit();

  const RangeFunction& function() const { return function_; }
  /// Of function(): all, and those of the functions that are constant along z.
  double unknowns() const { return unknowns_; }
  double unknowns_around() const { return unknowns_around_; }
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
  // What the function leaves of a cell's accepted samples: where they lie densest and how wide, at least the scale; and
  // the standard deviation that judges samples by their distance to the function.
  struct Spread {
    double middle = 0, width = 0, limit = 0;
  };
  enum class Weights { about_cluster, about_cell, about_function };
  bool iterate(std::initializer_list<Weights> steps);
  double rise_beside(std::size_t cell, int rows) const;
  bool follow_handles();
  static constexpr int kParts = 4;  // of the cells, for the executor
  void over_parts(const std::function<void(int part, std::size_t first, std::size_t last)>& work) const;
  void accumulate(Weights weights, std::size_t first, std::size_t last, MomentGrid& grid) const;
  bool solve(Weights weights);
  void find_spreads(std::size_t first, std::size_t last, std::vector<double>& sizes);
  void update_limits();

  GridSpecification specification_;
  JointContinuity continuity_;
  Executor executor_;
  SampleCells cells_;
  std::vector<Spread> spreads_;
  RangeFunction function_;
  std::optional<CellPolynomials> polynomials_;  // of the function
  double scale_ = 0, unknowns_ = 0, unknowns_around_ = 0;
  bool strangers_ = false;
};

}  // namespace celadon
