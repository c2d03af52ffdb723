#pragma once
// Stops of the axes beside the table: which ones a scan makes, and how head and lift get there. At each the table makes
// a turn with each laser: README.md, "Elevation and lift".

#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/axis_stop.h"
#include "acquisition/calibration.h"
#include "daemon/scan_job.h"
#include "daemon/scan_service.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon {

/// The travels of the axes that a machine has; none without a machine.
AxisTravels travels_of(const ScannerDevice* device);

/// Every elevation asked for at every height of the lift, in the order of their turns, the lift moving least; the ones
/// at 0 where none is asked for.
/// @returns one sentence with value and remedy where the machine or its calibration has no such axis, or it does not
/// reach that far
tl::expected<std::vector<AxisStop>, std::string> stops_of(const ScanRequest& request, const Calibration& calibration,
                                                          const AxisTravels& travels);

/// The stops that a recording holds, whatever was asked for.
tl::expected<std::vector<AxisStop>, std::string> stops_of(const RecordedScan& recorded, const Calibration& calibration);

/// Homes the axes that need it and moves them, if the machine has them. @pre all lasers are off
/// @returns where they came to rest, as their controller says; 0 of an axis that is not calibrated
tl::expected<AxisStop, ScanStop> bring_axes_to(const AxisStop& stop, ScannerDevice& device,
                                               const Calibration& calibration);

/// "elevation 20.00 degrees, lift 30.00 mm"; only what is not 0, empty for none.
std::string text_of(const AxisStop& stop);

}  // namespace celadon
