#pragma once
// Where the axes beside the table stand while the table makes a turn.

namespace celadon {

/// Readings of the axes, as the controller gives them; 0 where the machine has no such axis.
struct AxisStop {
  double elevation_rad = 0;
  double lift_mm = 0;
  bool operator==(const AxisStop&) const = default;
};

}  // namespace celadon
