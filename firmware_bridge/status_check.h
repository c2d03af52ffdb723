#pragma once
// Two polls of one controller that cannot both be true: an encoder that jumped, a clock that was set.

#include <optional>
#include <string>

#include "firmware_bridge/scanner_device.h"

namespace celadon {

struct Contradiction {
  std::string cause;
  bool position = false;  ///< the position is not to be trusted before the next homing
};

/// What the later of two polls says that cannot follow from the earlier one; nullopt: it can.
/// - Clocks: the controller's clock has to advance as far as the host's, within both exchanges, 20 ms and 0.1 %.
/// - Position: between two samples of a homed axis at most its greatest acceleration a acts, so that
///   |x1 - x0 - (v0 + v1) T / 2| <= a T^2 / 4; 0.2 degrees more for a table that swings on its coupling; where the host
///   stamps, also what the table turns in both exchanges. Without a
///   command in between an axis that stood and stands has not moved.
/// @pre both are of the same start of the controller
std::optional<Contradiction> contradiction(const DeviceStatus& before, const DeviceStatus& now, bool commanded_between,
                                           const DeviceCapabilities& capabilities);

/// The same of any axis's position alone: how it jumped, one clause. For a lift millimetres, and 0.2 mm instead of 0.2
/// degrees; unknown_s: by how much the instants of both samples together may be wrong.
std::optional<std::string> position_jump(AxisKind kind, const AxisStatus& before, const AxisStatus& now,
                                         bool commanded_between, double max_acceleration, double unknown_s = 0);

}  // namespace celadon
