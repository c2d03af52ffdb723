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
/// What is left of the values after their mean and the first two harmonics.
std::vector<double> beyond_harmonics(const std::vector<double>& around);

/// Values of fields of equal angle all around, gaps closed with what lies beside them; nullopt: fewer than nine in ten
/// have one.
std::optional<std::vector<double>> closed_around(const std::vector<std::optional<double>>& fields);

}  // namespace celadon
