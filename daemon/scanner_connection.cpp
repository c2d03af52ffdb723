#include "daemon/scanner_connection.h"

#include "daemon/sim_control.h"
#include "firmware_bridge/transport.h"

namespace celadon {
namespace {

constexpr const char* kSim = "sim:";

tl::unexpected<ConnectError> unconnected(const std::string& message, bool wrong_configuration = false) {
  return tl::make_unexpected(ConnectError{message, wrong_configuration});
}

}  // namespace

tl::expected<ScannerConnection, ConnectError> connect_scanner(const std::string& device_url,
                                                              const std::string& camera_url,
                                                              const Calibration& calibration) {
  ScannerConnection connection;
  connection.clock = std::make_unique<MonotonicClock>();
  if (camera_url.rfind(kSim, 0) == 0) {
    const std::string folder = camera_url.substr(std::string(kSim).size());
    auto control = SimControl::open(folder);
    if (!control) return unconnected(control.error());
    auto for_truth = SimControl::open(folder);
    if (!for_truth) return unconnected(for_truth.error());
    connection.truth = std::make_unique<SimTruth>(std::move(*for_truth));
    if ((*control)->lock_step()) connection.clock = std::make_unique<SimClock>(std::move(*control));
  }

  if (device_url.empty()) {
    auto recording = open_frame_source(camera_url);
    if (!recording) return unconnected(recording.error().message, true);
    connection.camera = std::move(*recording);
    const CameraMode& mode = connection.camera->mode();
    auto checked = check_calibration(calibration, calibration.machine, mode.identity, mode.width_px, mode.height_px);
    if (!checked) return unconnected(checked.error().message, true);
    return connection;
  }
  auto transport = open_transport(device_url);
  // Before there is a machine, a refusal is one of the address.
  if (!transport) return unconnected(transport.error().message(), transport.error().kind == DeviceError::Kind::refused);
  auto device = ScannerDevice::open(std::move(*transport), *connection.clock);
  if (!device) {
    return unconnected(device.error().message(), device.error().kind == DeviceError::Kind::wrong_protocol);
  }
  connection.device = std::move(*device);

  auto camera = open_frame_source(camera_url);
  if (!camera) return unconnected(camera.error().message);
  connection.camera = std::move(*camera);

  const CameraMode& mode = connection.camera->mode();
  auto checked = check_calibration(calibration, connection.device->identity().machine, mode.identity, mode.width_px,
                                   mode.height_px);
  if (!checked) return unconnected(checked.error().message, true);
  if (calibration.lasers.front().laser >= connection.device->capabilities().lasers) {
    return unconnected("The calibration is for laser " + std::to_string(calibration.lasers.front().laser) +
                           ", but the machine has lasers 0 to " +
                           std::to_string(connection.device->capabilities().lasers - 1) +
                           "; calibrate this machine or give its calibration.",
                       true);
  }
  return connection;
}

}  // namespace celadon
