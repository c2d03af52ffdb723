#pragma once
// "from 30 to 75 degrees": parts of the turn as an operator reads them.

#include <cmath>
#include <cstddef>
#include <cstdio>
#include <string>

namespace celadon {

/// The sectors for which it holds, as one stretch that may go over 360 degrees; or "all around".
/// @param sectors  of equal width, the first from 0 on
/// @param holds    bool(std::size_t sector); @pre it does for one at least
template <class Holds>
std::string sectors_in_words(std::size_t sectors, const Holds& holds) {
  std::size_t longest_gap = 0, after_gap = 0, count = 0;
  for (std::size_t k = 0; k < sectors; ++k) count += holds(k);
  if (count == sectors) return "all around";
  for (std::size_t k = 0; k < sectors; ++k) {
    std::size_t gap = 0;
    while (gap < sectors && !holds((k + gap) % sectors)) ++gap;
    if (gap > longest_gap) longest_gap = gap, after_gap = (k + gap) % sectors;
  }
  const double width_deg = 360. / static_cast<double>(sectors);
  const double first_deg = static_cast<double>(after_gap) * width_deg,
               last_deg = std::fmod(first_deg + static_cast<double>(sectors - longest_gap) * width_deg, 360.);
  char out[48];
  std::snprintf(out, sizeof out, "from %.0f to %.0f degrees", first_deg, last_deg == 0 ? 360. : last_deg);
  return out;
}

}  // namespace celadon
