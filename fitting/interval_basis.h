#pragma once
// B-splines as power polynomials of each knot interval: what evaluation at many points reads.

#include <span>
#include <vector>

namespace celadon {

/// The degree + 1 functions of each knot interval in s in [-1, 1], padded with zero functions to width().
class IntervalBasis {
 public:
  IntervalBasis() = default;
  /// @pre knots clamped, degree 0..5
  IntervalBasis(std::span<const double> knots, int degree);

  int degree() const { return degree_; }
  /// 4 up to degree 3, else 6.
  int width() const { return degree_ <= 3 ? 4 : 6; }
  /// Interval of t, the last one at the end; `near` is tried first. NaN goes anywhere.
  int locate(double t, int near) const;
  /// Index of the first of the functions of an interval.
  int first(int interval) const { return first_[static_cast<std::size_t>(interval)]; }
  /// Values of the width() functions at t.
  template <int kWidth>
  void values(int interval, double t, double* N) const {
    const auto k = static_cast<std::size_t>(interval);
    const double s = (t - breaks_[k]) * scale_[k] - 1;
    const double* power = power_.data() + k * static_cast<std::size_t>((degree_ + 1) * kWidth);
    const double* row = power + degree_ * kWidth;
    for (int a = 0; a < kWidth; ++a) N[a] = row[a];
    while (row != power) {
      row -= kWidth;
      for (int a = 0; a < kWidth; ++a) N[a] = N[a] * s + row[a];
    }
  }

 private:
  bool holds(int interval, double t) const {
    const auto k = static_cast<std::size_t>(interval);
    return breaks_[k] <= t && t < breaks_[k + 1];
  }
  int degree_ = 0;
  double uniform_scale_ = 0;            // intervals per unit of t, were they all alike
  std::vector<double> breaks_, scale_;  // scale: 2/(hi - lo)
  std::vector<int> first_;
  std::vector<double> power_;  // per interval degree + 1 rows (constant first) of width() functions
};

}  // namespace celadon
