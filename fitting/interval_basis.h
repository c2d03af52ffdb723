#pragma once
// B-splines as power polynomials of each knot interval: what evaluation at many points reads.

#include <algorithm>
#include <cmath>
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
  /// 4 up to degree 3, else 8.
  int width() const { return degree_ <= 3 ? 4 : 8; }
  /// Interval of t, the first or last one outside; NaN goes anywhere. `near` is tried first; then a guess, good where
  /// breaks are nearly uniform. Branches are the same ones for points in any order.
  int locate(double t, int near) const {
    if (std::abs(local(near, t)) < 1) return near;
    const double guess = std::min(std::max(0.0, (t - breaks_.front()) * uniform_scale_), last_);
    const double* at = breaks_.data() + static_cast<int>(guess);
    while (t < *at && at != breaks_.data()) --at;
    while (t >= at[1] && at != begin_of_last()) ++at;
    return static_cast<int>(at - breaks_.data());
  }
  int intervals() const { return static_cast<int>(first_.size()); }
  double start(int interval) const { return breaks_[static_cast<std::size_t>(interval)]; }
  /// 2/(end - start): local = (t - start) scale - 1.
  double scale(int interval) const { return scale_[static_cast<std::size_t>(interval)]; }
  /// Index of the first of the functions of an interval.
  int first(int interval) const { return first_[static_cast<std::size_t>(interval)]; }
  /// Local coordinate s in [-1, 1] of t on an interval.
  double local(int interval, double t) const {
    const auto k = static_cast<std::size_t>(interval);
    return (t - breaks_[k]) * scale_[k] - 1;
  }
  /// Power coefficients in s on an interval: degree() + 1 rows, constant first, of width() functions.
  const double* power(int interval) const {
    return power_.data() + static_cast<std::size_t>(interval * (degree_ + 1) * width());
  }

 private:
  const double* begin_of_last() const { return breaks_.data() + first_.size() - 1; }
  int degree_ = 0;
  double uniform_scale_ = 0;            // intervals per unit of t, were they all alike
  double last_ = 0;                     // index of the last interval
  std::vector<double> breaks_, scale_;  // scale: 2/(hi - lo)
  std::vector<int> first_;
  std::vector<double> power_;  // per interval degree + 1 rows (constant first) of width() functions
};

}  // namespace celadon
