#pragma once
// When a machine is to be calibrated again: by age, by use, and by what its scans found of it.

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "acquisition/calibration.h"
#include "daemon/scan_service.h"

namespace celadon {

/// Why the calibration is due, a sentence each; empty: it is not. Scans count that were done after its date. Of a check
/// that tells on the calibration, whatever the object, its newest verdict counts: what failed once and passed since
/// was the object's.
/// @param now_unix_s  seconds since 1970, UTC; before the calibration's date: its age says nothing
std::vector<std::string> calibration_due(const Calibration& calibration, const CalibrationLimits& limits,
                                         const std::map<std::uint64_t, ScanRecord>& scans, std::int64_t now_unix_s);

}  // namespace celadon
