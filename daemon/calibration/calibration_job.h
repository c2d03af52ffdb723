#pragma once
// One calibration from the first poll to the verdicts, on a machine that somebody else owns.

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibration.h"
#include "daemon/calibration/calibration_guide.h"
#include "daemon/calibration/calibration_record.h"
#include "daemon/scan_job.h"
#include "daemon/scanner_connection.h"

namespace celadon {

/// What came of the views.
struct CalibrationOutcome {
  std::optional<Calibration> calibration;  ///< with the machine's names and the date; nullopt: it is refused
  std::string verdict;                     ///< the worst of the steps
  std::vector<StepVerdict> steps;
  CalibrationValues values;
};

/// Views, made safe, solved, judged; nothing is written.
/// @param from_afar  asked for by somebody who may not stand at the machine
/// @pre calibration_request_from_json() takes the request
/// @returns a stop with ScanFailure::data if no parameters can be given at all
tl::expected<CalibrationOutcome, ScanStop> run_calibration(ScannerConnection& machine,
                                                           const CalibrationRequest& request, bool from_afar,
                                                           CalibrationGuide& guide);

/// run_calibration(), or what stands in its place.
using RunCalibration = std::function<tl::expected<CalibrationOutcome, ScanStop>(
    ScannerConnection& machine, const CalibrationRequest& request, bool from_afar, CalibrationGuide& guide)>;

}  // namespace celadon
