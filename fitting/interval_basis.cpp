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
  last_ = static_cast<double>(intervals - 1);
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

}  // namespace celadon
