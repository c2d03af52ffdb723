#pragma once
// Harmonics around of what a surface misses its samples by. Source: README.md, "Self-checks".

#include <array>
#include <optional>
#include <vector>

#include "fitting/error_map.h"

namespace celadon {

/// Mean error of each field of angle over the height, outward positive; nullopt: fewer than nine in ten have samples.
std::optional<std::vector<double>> errors_around(const ErrorMap& map);

/// Amplitude of cos(k theta + phase) in values at equal angles all around, k = 1, 2.
std::array<double, 2> first_harmonics(const std::vector<double>& around);
/// Root mean square of what is left of the values after their mean and the first two harmonics.
double rms_beyond_harmonics(const std::vector<double>& around);

}  // namespace celadon
