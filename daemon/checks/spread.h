#pragma once
// How far values scatter, told by the middle ones: a few that are far off do not count.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace celadon {

/// The upper one of the two middle values where their number is even; 0 of none.
inline double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// The standard deviation about `middle` that normal values with this median distance from it would have.
inline double robust_deviation(std::vector<double> values, double middle) {
  for (double& value : values) value = std::abs(value - middle);
  return 1.4826 * median(std::move(values));
}

}  // namespace celadon
