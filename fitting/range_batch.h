#pragma once
// A range function and its derivatives at many points, in any order of points, on SIMD lanes.
// Source: README.md, "Batches".

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "fitting/aligned_allocator.h"
#include "fitting/range_function.h"

namespace celadon {

/// Arrays of the length of a batch. Null where they are not wanted: slopes come together, so do second derivatives
/// and then slopes are there too.
struct DerivativeArrays {
  double* r_mm;
  double *r_theta = nullptr, *r_z = nullptr;
  double *r_theta_theta = nullptr, *r_theta_z = nullptr, *r_z_z = nullptr;
};

/// The intervals of a knot vector, found by one look into a table of even steps.
class IntervalTable {
 public:
  explicit IntervalTable(const std::vector<double>& breaks);
  /// The interval of t, the first or last one outside; not-a-number goes to the first.
  std::size_t locate(double t) const {
    const double step = (t - breaks_.front()) * steps_per_unit_;
    std::size_t k = table_[static_cast<std::size_t>(step > 0 ? (step < last_step_ ? step : last_step_) : 0)];
    while (t < breaks_[k] && k > 0) --k;
    while (t >= breaks_[k + 1] && k + 2 < breaks_.size()) ++k;
    return k;
  }
  bool first(std::size_t interval) const { return interval == 0; }
  bool last(std::size_t interval) const { return interval + 2 == breaks_.size(); }
  double start(std::size_t interval) const { return breaks_[interval]; }
  /// 2/(end - start).
  double scale(std::size_t interval) const { return scale_[interval]; }

 private:
  std::vector<double> breaks_, scale_;
  std::vector<std::uint32_t> table_;
  double steps_per_unit_, last_step_;
};

/// The same as RangeFunction::derivatives up to rounding. A point's values have the same bits alone, in a batch, and at
/// every SIMD level.
class RangeBatch {
 public:
  explicit RangeBatch(const RangeFunction& function);
  /// At (v, along), v as BaseArcs gives it and `along` as BaseSurface says (r_z is the slope along it); outside the
  /// band the rim's; from the right at breaks. Arrays of length n.
  void evaluate(const double* v, const double* along, std::size_t n, const DerivativeArrays& out) const;
  /// Positions, normals and principal curvatures at (theta, along), as RangeFunction::surface_point gives them. Arrays
  /// of length n.
  void surface_points(const double* theta_rad, const double* along, std::size_t n, SurfacePoint* points) const;

  /// What the kernels read.
  struct Cell {
    double start_u, end_u, start_v, end_v;  ///< half open; without end at the rims
    double origin_u, scale_u, origin_v, scale_v;
    const double* coefficients;  ///< of s^a t^b at a * width() + b, s and t local coordinates in [-1, 1]
    bool holds(double u, double v) const { return u >= start_u && u < end_u && v >= start_v && v < end_v; }
  };
  Cell cell_at(double u, double v) const {
    constexpr double kNone = std::numeric_limits<double>::infinity();
    const std::size_t i = along_u_.locate(u), j = along_v_.locate(v);
    return {along_u_.first(i) ? -kNone : along_u_.start(i),
            along_u_.last(i) ? kNone : along_u_.start(i + 1),
            along_v_.first(j) ? -kNone : along_v_.start(j),
            along_v_.last(j) ? kNone : along_v_.start(j + 1),
            along_u_.start(i),
            along_u_.scale(i),
            along_v_.start(j),
            along_v_.scale(j),
            coefficients_.data() + (j * rows_ + i) * stride_};
  }
  int degree_u() const { return degree_u_; }
  int degree_v() const { return degree_v_; }
  /// 4 up to degree 3 in v, else 8; zeros beyond the degree.
  int width() const { return degree_v_ <= 3 ? 4 : 8; }
  /// u = (along - origin) per_unit, within [u_start, u_end].
  double origin() const { return origin_; }
  double per_unit() const { return per_unit_; }
  double u_start() const { return u_start_; }
  double u_end() const { return u_end_; }
  /// theta'(v) = sine / W, W = 1 - bulge eta (1 - eta), eta the part of v behind the joint.
  double sine() const { return sine_; }
  double bulge() const { return bulge_; }

 private:
  SurfacePoint pole(double along) const;
  BaseSurface base_;
  IntervalTable along_u_, along_v_;
  int degree_u_, degree_v_;
  std::size_t rows_, stride_;
  double origin_, per_unit_, u_start_, u_end_, sine_, bulge_;
  AlignedVector<double> coefficients_;
};

}  // namespace celadon
