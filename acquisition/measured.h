#pragma once

namespace celadon {

/// A number and its standard uncertainty (same unit).
struct Measured {
  double value = 0, u = 0;
  bool operator==(const Measured&) const = default;
};

}  // namespace celadon
