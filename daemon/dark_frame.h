#pragma once
// A laser that shines although it is switched off, found by the camera: the controller's own sensor may be what failed.

#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "acquisition/frame.h"
#include "acquisition/triangulation.h"
#include "daemon/scan_preparation.h"

namespace celadon {

/// Looks at the first frame whose exposure began after `dark_since_ns`. @returns one sentence for the operator if it
/// shows a line about as long and at least a third as bright as the one before the scan; nullopt without it, and
/// without a frame, which is for others to complain of
/// @param turn_rad  the table's angle
/// @pre the camera streams and nobody else takes its frames; no lease of a frame is out
std::optional<std::string> light_although_off(FrameSource& camera, const Triangulator& triangulator,
                                              const ScanPreparation& seen, std::int64_t dark_since_ns, double turn_rad);

/// The same of the mean frame that was taken with the laser off before the scan, when nothing is added to it by
/// switching the laser on.
std::optional<std::string> light_in_background(const CameraMode& mode, std::span<const std::uint8_t> background,
                                               LineAlong along);

}  // namespace celadon
