#pragma once
// What of a machine the calibration does not say, as JSON.

#include <nlohmann/json_fwd.hpp>

#include "sim/device_model.h"

namespace celadon::sim {

/// Every effect beyond the calibrated model with its parameters, 0 (fields: contrast 1) where the machine has none; the
/// formulas are in effects.h, optics.h and turntable.h.
nlohmann::json effects_of(const DeviceConfig& device);

}  // namespace celadon::sim
