#pragma once
// Device, camera, clock and, with a simulator, truth: opened together, checked against each other and the calibration.

#include <memory>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/calibration.h"
#include "acquisition/frame.h"
#include "daemon/scan_truth.h"
#include "firmware_bridge/clock.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon {

/// The one owner of machine and camera. Members close in the order that keeps borrowed ones alive.
struct ScannerConnection {
  std::unique_ptr<Clock> clock;
  std::unique_ptr<TruthSource> truth;  ///< simulators only
  std::unique_ptr<ScannerDevice> device;
  std::unique_ptr<FrameSource> camera;
};

/// Why there is no connection: one sentence. `wrong_configuration`: trying again cannot help (calibration of another
/// machine, another protocol version, an address that makes no sense).
struct ConnectError {
  std::string message;
  bool wrong_configuration = false;
};

/// Opens everything. The clock is the simulator's when the camera is "sim:FOLDER" in lock-step.
tl::expected<ScannerConnection, ConnectError> connect_scanner(const std::string& device_url,
                                                              const std::string& camera_url,
                                                              const Calibration& calibration);

}  // namespace celadon
