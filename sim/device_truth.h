#pragma once
// What of a machine the calibration does not say, as JSON.

#include <nlohmann/json_fwd.hpp>

#include "sim/device_model.h"

namespace celadon::sim {

/// Every effect beyond the calibrated model with its parameters, 0 (fields: contrast 1) where the machine has none; the
/// formulas are in effects.h, optics.h and turntable.h.
nlohmann::json effects_of(const DeviceConfig& device);

/// Corners of calibration targets that lie in the picture with the machine in a posture: tag (0 of a
/// chessboard), corner, pixel, and the point in the scanner frame. Hidden behind the object or not.
nlohmann::json corners_of(const DeviceConfig& device, const Scene& scene, const Posture& posture);

}  // namespace celadon::sim
