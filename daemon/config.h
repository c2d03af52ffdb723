#pragma once
// Configuration of celadond: a TOML file, overridden by the command line. Every key is in README.md.

#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/triangulation.h"
#include "daemon/button_options.h"
#include "daemon/scan_service.h"

namespace celadon {

/// [drive]: the device is a drive of another maker (firmware_bridge/DRIVE_PROFILES.md).
struct DriveConfig {
  std::string profile, io_profile;  ///< a name or a file
  std::string io;                   ///< URL of the I/O device
  std::string serial;               ///< of the machine
  double steps_per_turn = 0;        ///< of the motor; 0: the profile's
  double motor_turns_per_turn = 1;
  double max_speed_deg_per_s = 0, max_acceleration_deg_per_s2 = 0;
  bool homes_at_mark = false;
};

/// [motion]: what the table may do beside what the controller allows.
struct MotionConfig {
  double lowest_deg = -std::numeric_limits<double>::infinity(), highest_deg = std::numeric_limits<double>::infinity();
  double jerk_deg_per_s3 = 0;  ///< 0: trapezoids
};

struct Config {
  std::string device;                ///< "modbus-tcp://..", "modbus-rtu:..", "usb:.."; empty with a recording
  std::optional<DriveConfig> drive;  ///< none: the device is a controller of the protocol
  MotionConfig motion;
  std::string camera;                 ///< "v4l2:..", "sim:FOLDER", "replay:FOLDER"
  std::filesystem::path calibration;  ///< file, which need not exist yet; empty: calibration.toml in the store
  std::filesystem::path store;        ///< folder of scans
  std::filesystem::path record;       ///< folder for the frames of each scan (REPLAY.md); empty: they are not kept
  std::string http_address = "127.0.0.1";
  std::uint16_t http_port = 7450;  ///< 0: any free one
  std::string unix_socket;         ///< path; empty: none
  std::string log_level = "info";
  std::string button;     ///< "evdev:..", "gpio:.."; empty: the machine's own alone
  ButtonOptions presses;  ///< without `open`
  ScanRequest scan;       ///< what a press of the button starts; defaults for nothing else
  ScanVolume volume;
  CalibrationLimits calibration_limits;
};

struct ConfigError {
  std::string message;
};  ///< names file, line or option, value and remedy

/// Reads a file over `config`; keys that are not there stay as they are.
tl::expected<void, ConfigError> read_config(const std::filesystem::path& file, Config& config);
/// Checks what a daemon cannot start without.
tl::expected<void, ConfigError> check_config(const Config& config);

}  // namespace celadon
