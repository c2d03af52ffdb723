#pragma once
// The nodes of a map of standard deviations, and the map of any function of the place. Internal to fitting/.

#include <functional>
#include <vector>

#include "fitting/deviation_map.h"

namespace celadon {

/// Where the standard deviation of one direction bends: the breaks of its functions, and places next to which it falls
/// steeply: the outer breaks, if it ends there, and where the range is held.
struct DeviationBreaks {
  const std::vector<double>& breaks;
  bool ends;
  std::vector<double> held{};
};

/// Of sd_mm(v, along) over the band [start, end].
DeviationMap deviation_map(const std::function<double(double v, double along)>& sd_mm, const DeviationBreaks& along,
                           const DeviationBreaks& around, double start, double end);

}  // namespace celadon
