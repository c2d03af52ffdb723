#pragma once
// What the datum says of a scan: table, camera, clocks and lasers against the calibration, whatever stood on the table.

#include <vector>

#include "acquisition/calibration.h"
#include "daemon/checks/self_check.h"
#include "daemon/datum_watch.h"

namespace celadon {

/// "datum_turn", "datum_angle", "datum_time", "datum_camera", and "datum_laser N" for each laser of the scan, in this
/// order; in place of the first four "datum", not verifiable, where the calibration knows no fiducials. Limits:
/// README.md, "Self-checks".
std::vector<SelfCheck> datum_checks(const DatumEvidence& evidence, const Calibration& calibration);

}  // namespace celadon
