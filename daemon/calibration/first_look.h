#pragma once
// A machine that nobody has measured yet, looked at for the first time: does it see its lasers, and which way does its
// table turn.

#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/scan_job.h"
#include "daemon/scanner_connection.h"

namespace celadon {

/// One laser's line on whatever stands there.
struct LaserLook {
  int laser = 0;
  int lines = 0, of = 0;  ///< rows of the picture with a line
  int saturated = 0;      ///< of them
  double amplitude = 0;   ///< mean, grey levels
};

/// Interlock, lasers dark, index found: the self-test of a machine without a calibration. @return what was seen
tl::expected<std::string, ScanStop> test_unmeasured(ScannerConnection& machine, ScanObserver& observer);
/// Each laser on by itself for a few frames, the table at rest. On every way out the lasers are off.
tl::expected<std::vector<LaserLook>, ScanStop> look_at_lasers(ScannerConnection& machine, ScanObserver& observer);
/// Turns the table on by an angle. On every way out the motor stands.
tl::expected<void, ScanStop> turn_by(double angle_rad, ScannerConnection& machine, ScanObserver& observer);

}  // namespace celadon
