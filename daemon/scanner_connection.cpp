#include "daemon/scanner_connection.h"

#include <numbers>

#include <spdlog/spdlog.h>

#include "daemon/drive_profile_reader.h"
#include "daemon/sim_control.h"
#include "firmware_bridge/foreign_drive.h"
#include "firmware_bridge/transport.h"

namespace celadon {
namespace {

constexpr const char* kSim = "sim:";

tl::unexpected<ConnectError> unconnected(const std::string& message, bool wrong_configuration = false) {
  return tl::make_unexpected(ConnectError{message, wrong_configuration});
}

// Before there is a machine, a refusal is one of the address or of what it was told to be.
ConnectError connect_error(const DeviceError& error) {
  return {error.message(), error.kind == DeviceError::Kind::refused};
}

tl::expected<std::unique_ptr<Transport>, ConnectError> open_drive(const DriveConfig& config, const std::string& url,
                                                                  Clock& clock) {
  ForeignMachine machine;
  auto drive = read_drive_profile(config.profile);
  if (!drive) return unconnected(drive.error(), true);
  auto io = read_io_profile(config.io_profile);
  if (!io) return unconnected(io.error(), true);
  machine.drive = std::move(*drive);
  machine.io = std::move(*io);
  machine.serial = config.serial;
  machine.steps_per_turn = config.steps_per_turn;
  machine.motor_turns_per_turn = config.motor_turns_per_turn;
  machine.max_speed_deg_per_s = config.max_speed_deg_per_s;
  machine.max_acceleration_deg_per_s2 = config.max_acceleration_deg_per_s2;
  machine.homes_at_mark = config.homes_at_mark;
  auto to_io = open_transport(config.io);
  if (!to_io) return tl::make_unexpected(connect_error(to_io.error()));
  auto to_drive = open_transport(url);
  if (!to_drive) return tl::make_unexpected(connect_error(to_drive.error()));
  return open_foreign_machine(machine, std::move(*to_drive), std::move(*to_io), clock).map_error(connect_error);
}

/// Clock and, of a simulator, truth.
tl::expected<void, ConnectError> open_simulator(const std::string& camera_url, ScannerConnection& connection) {
  connection.clock = std::make_unique<MonotonicClock>();
  if (camera_url.rfind(kSim, 0) != 0) return {};
  const std::string folder = camera_url.substr(std::string(kSim).size());
  auto control = SimControl::open(folder);
  if (!control) return unconnected(control.error());
  auto for_truth = SimControl::open(folder);
  if (!for_truth) return unconnected(for_truth.error());
  connection.truth = std::make_unique<SimTruth>(std::move(*for_truth));
  if ((*control)->lock_step()) connection.clock = std::make_unique<SimClock>(std::move(*control));
  return {};
}

}  // namespace

tl::expected<ScannerConnection, ConnectError> open_scanner(const std::string& device_url, const std::string& camera_url,
                                                           const std::optional<DriveConfig>& drive,
                                                           const MotionConfig& motion) {
  ScannerConnection connection;
  if (auto opened = open_simulator(camera_url, connection); !opened) return tl::make_unexpected(opened.error());
  auto transport =
      drive ? open_drive(*drive, device_url, *connection.clock) : open_transport(device_url).map_error(connect_error);
  if (!transport) return tl::make_unexpected(std::move(transport.error()));
  if (const std::string warning = (*transport)->warning(); !warning.empty()) spdlog::warn("{}", warning);
  auto device = ScannerDevice::open(std::move(*transport), *connection.clock);
  if (!device) {
    return unconnected(device.error().message(), device.error().kind == DeviceError::Kind::wrong_protocol);
  }
  connection.device = std::move(*device);
  constexpr double kRad_per_deg = std::numbers::pi / 180;
  if (auto set = connection.device->set_motion_limits(
          {motion.lowest_deg * kRad_per_deg, motion.highest_deg * kRad_per_deg, motion.jerk_deg_per_s3 * kRad_per_deg});
      !set) {
    return tl::make_unexpected(connect_error(set.error()));
  }

  auto camera = open_frame_source(camera_url);
  if (!camera) return unconnected(camera.error().message);
  connection.camera = std::move(*camera);

  return connection;
}

tl::expected<ScannerConnection, ConnectError> connect_scanner(const std::string& device_url,
                                                              const std::string& camera_url,
                                                              const Calibration& calibration,
                                                              const std::optional<DriveConfig>& drive,
                                                              const MotionConfig& motion) {
  if (device_url.empty()) {
    ScannerConnection connection;
    if (auto opened = open_simulator(camera_url, connection); !opened) return tl::make_unexpected(opened.error());
    auto recording = open_frame_source(camera_url);
    if (!recording) return unconnected(recording.error().message, true);
    connection.camera = std::move(*recording);
    const CameraMode& mode = connection.camera->mode();
    auto checked = check_calibration(calibration, calibration.machine, mode.identity, mode.width_px, mode.height_px);
    if (!checked) return unconnected(checked.error().message, true);
    return connection;
  }
  auto opened = open_scanner(device_url, camera_url, drive, motion);
  if (!opened) return opened;
  ScannerConnection& connection = *opened;
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
  return opened;
}

}  // namespace celadon
