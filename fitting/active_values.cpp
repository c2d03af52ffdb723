#include "fitting/active_values.h"

#include <algorithm>

namespace celadon {

int interval_at(const RangeSpace& space, double t) {
  const auto& breaks = space.breaks();
  return static_cast<int>(std::upper_bound(breaks.begin() + 1, breaks.end() - 1, t) - breaks.begin()) - 1;
}

ActiveValues::ActiveValues(const RangeSpace& space, double t, int order) {
  const int interval = interval_at(space, t);
  const auto at = static_cast<std::size_t>(interval);
  const double lo = space.breaks()[at], hi = space.breaks()[at + 1];
  const double s = 2 * (std::clamp(t, lo, hi) - lo) / (hi - lo) - 1;
  const auto active = space.active(interval);
  for (; count < active.size(); ++count) {
    const auto polynomial = space.polynomial(interval, static_cast<int>(count));
    double slope = 0;
    for (std::size_t i = polynomial.size(); i-- > 0;) {
      slope = slope * s + value[count];
      value[count] = value[count] * s + polynomial[i];
    }
    if (order > 0) value[count] = slope * 2 / (hi - lo);
    index[count] = active[count];
  }
}

}  // namespace celadon
