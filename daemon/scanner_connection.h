#pragma once
// Device, camera, clock and, with a simulator, truth: opened together, checked against each other and the calibration.

#include <memory>
#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/calibration.h"
#include "acquisition/frame.h"
#include "daemon/config.h"
#include "daemon/scan_truth.h"
#include "firmware_bridge/clock.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon {

/// The one owner of machine and camera. Members close in the order that keeps borrowed ones alive.
struct ScannerConnection {
  std::unique_ptr<Clock> clock;
  std::unique_ptr<TruthSource> truth;     ///< simulators only
  std::unique_ptr<ScannerDevice> device;  ///< none with a recording
  std::unique_ptr<FrameSource> camera;
};

inline bool is_simulated(const ScannerConnection& connection) {
  return (connection.device && connection.device->identity().simulated) || connection.camera->mode().simulated;
}

/// Why there is no connection: one sentence. `wrong_configuration`: trying again cannot help (calibration of another
/// machine, another protocol version, an address that makes no sense).
struct ConnectError {
  std::string message;
  bool wrong_configuration = false;
};

/// Opens machine and camera, whatever their calibration. The clock is the simulator's when the camera is "sim:FOLDER"
/// in lock-step. With a drive the device's URL is the drive's.
/// @pre device_url is not empty
tl::expected<ScannerConnection, ConnectError> open_scanner(const std::string& device_url, const std::string& camera_url,
                                                           const std::optional<DriveConfig>& drive = std::nullopt,
                                                           const MotionConfig& motion = {});

/// The same, checked against a calibration; of a recording ("replay:FOLDER") the camera alone.
tl::expected<ScannerConnection, ConnectError> connect_scanner(const std::string& device_url,
                                                              const std::string& camera_url,
                                                              const Calibration& calibration,
                                                              const std::optional<DriveConfig>& drive = std::nullopt,
                                                              const MotionConfig& motion = {});

}  // namespace celadon
