#pragma once
// What is taken for granted of a machine that nobody has measured yet.

#include "acquisition/calibration.h"
#include "daemon/scanner_connection.h"

namespace celadon {

/// Nothing, but that no frame was exposed earlier than two periods and an exposure before its stamp.
Calibration nothing_known(const ScannerConnection& machine);

/// What a driver's stamp means: the end of the frame's readout, or its exposure's begin.
TimeModel assumed_time(const CameraMode& mode);

}  // namespace celadon
