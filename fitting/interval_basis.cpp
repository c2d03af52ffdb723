#include "fitting/interval_basis.h"

#include <algorithm>
#include <stdexcept>
#include <string>

#include "fitting/bspline_basis.h"
#include "fitting/knots.h"

namespace celadon {

IntervalBasis::IntervalBasis(std::span<const double> knots, int degree) : degree_(degree) {
  if (degree < 0 || degree > 5) throw std::invalid_argument("IntervalBasis: degree " + std::to_string(degree));
  breaks_ = breaks_of(knots).values;
  const std::size_t intervals = breaks_.size() - 1;
  const auto rows = static_cast<std::size_t>(degree) + 1, columns = static_cast<std::size_t>(width());
  uniform_scale_ = static_cast<double>(intervals) / (breaks_.back() - breaks_.front());
  power_.assign(intervals * rows * columns, 0.0);
  for (std::size_t k = 0; k < intervals; ++k) {
    const int span = find_span(knots, degree, breaks_[k]);
    const IntervalMatrix power = power_from_bezier(degree) * bezier_conversion(knots, degree, span);
    for (std::size_t row = 0; row < rows; ++row) {
      for (std::size_t a = 0; a < rows; ++a) {
        power_[(k * rows + row) * columns + a] = power(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(a));
      }
    }
    first_.push_back(span - degree);
    scale_.push_back(2 / (breaks_[k + 1] - breaks_[k]));
  }
}

int IntervalBasis::locate(double t, int near) const {
  if (holds(near, t)) return near;
  const int last = static_cast<int>(first_.size()) - 1;
  if (!(t > breaks_.front())) return 0;
  if (t >= breaks_.back()) return last;
  const int guess = std::min(static_cast<int>((t - breaks_.front()) * uniform_scale_), last);
  if (holds(guess, t)) return guess;
  return static_cast<int>(std::upper_bound(breaks_.begin(), breaks_.end(), t) - breaks_.begin()) - 1;
}

}  // namespace celadon
