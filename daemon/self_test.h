#pragma once
// What a long press of the button asks for: is the machine fit to scan, without scanning.

#include <string>

#include <tl/expected.hpp>

#include "daemon/scan_job.h"

namespace celadon {

/// Interlock closed and nothing stopped or locked; lasers dark by the controller's sensor, and to the camera; then the
/// index is found. Cancel and button end it. On every way out the lasers are off and the motor stands.
/// @return one sentence: what was seen
/// @pre equipment.device
tl::expected<std::string, ScanStop> self_test(const ScanEquipment& equipment, ScanObserver& observer);

}  // namespace celadon
