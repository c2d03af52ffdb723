#pragma once
// The functions of a space at one place. Internal to fitting/.

#include <array>
#include <cstddef>

#include "fitting/range_space.h"

namespace celadon {

/// Values of the free functions that do not vanish at t, or their slopes (order 1); t is clamped to the space.
struct ActiveValues {
  static constexpr int kMost = 6;
  std::array<int, kMost> index{};
  std::array<double, kMost> value{};
  std::size_t count = 0;
  ActiveValues(const RangeSpace& space, double t, int order = 0);
};

/// The interval that holds t, clamped to the space.
int interval_at(const RangeSpace& space, double t);

}  // namespace celadon
