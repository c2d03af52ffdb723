#include "daemon/config.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <sstream>
#include <string_view>

#include <nlohmann/json.hpp>

#include "acquisition/toml_section.h"

namespace celadon {
namespace {

constexpr std::array<const char*, 6> kLogLevels = {"trace", "debug", "info", "warn", "error", "off"};
constexpr double kLargestLength_mm = 10'000;

struct Problem {
  std::string text;
};

std::string line_of(const toml::node& node) {
  return "line " + std::to_string(node.source().begin.line) + ": ";
}

std::string text(const std::string& key, const toml::node& node) {
  if (const auto value = node.value_exact<std::string>()) return *value;
  throw Problem{line_of(node) + key + " is not a text; put it in quotes."};
}

double length_mm(const std::string& key, const toml::node& node) {
  const auto value = node.value<double>();
  if (value && std::isfinite(*value) && std::abs(*value) <= kLargestLength_mm) return *value;
  throw Problem{line_of(node) + key + " is not a length in millimetres between -10000 and 10000."};
}

const toml::table& table(const std::string& key, const toml::node& node) {
  if (const auto* t = node.as_table()) return *t;
  throw Problem{line_of(node) + key + " is not a section; write [" + key + "]."};
}

nlohmann::json to_json(const std::string& key, const toml::node& node) {
  if (const auto v = node.value_exact<std::string>()) return *v;
  if (const auto v = node.value_exact<std::int64_t>()) return *v;
  if (const auto v = node.value_exact<double>()) return *v;
  if (const auto v = node.value_exact<bool>()) return *v;
  if (const auto* list = node.as_array()) {
    auto json = nlohmann::json::array();
    for (const toml::node& entry : *list) json.push_back(to_json(key, entry));
    return json;
  }
  throw Problem{line_of(node) + key + " is no text, number or list."};
}

void read_http(const toml::table& section, Config& config) {
  for (const auto& [name, node] : section) {
    const std::string key = "http." + std::string(name.str());
    if (key == "http.address") {
      config.http_address = text(key, node);
    } else if (key == "http.port") {
      const auto port = node.value_exact<std::int64_t>();
      if (!port || *port < 0 || *port > 65535) throw Problem{line_of(node) + key + " is not a port from 0 to 65535."};
      config.http_port = static_cast<std::uint16_t>(*port);
    } else if (key == "http.unix_socket") {
      config.unix_socket = text(key, node);
    } else {
      throw Problem{line_of(node) + key + " is not known; [http] has address, port and unix_socket."};
    }
  }
}

std::int64_t milliseconds_ns(const std::string& key, const toml::node& node, std::int64_t low, std::int64_t high) {
  const auto value = node.value_exact<std::int64_t>();
  if (value && *value >= low && *value <= high) return *value * 1'000'000;
  throw Problem{line_of(node) + key + " is no whole number of milliseconds from " + std::to_string(low) + " to " +
                std::to_string(high) + "."};
}

PressMeaning meaning(const std::string& key, const toml::node& node) {
  const auto value = node.value_exact<std::string>();
  if (value == "scan") return PressMeaning::scan;
  if (value == "self-test") return PressMeaning::self_test;
  if (value == "nothing") return PressMeaning::nothing;
  throw Problem{line_of(node) + key + " is not \"scan\", \"self-test\" or \"nothing\"."};
}

void read_button(const toml::table& section, Config& config) {
  for (const auto& [name, node] : section) {
    const std::string key = "button." + std::string(name.str());
    if (key == "button.source") {
      config.button = text(key, node);
    } else if (key == "button.debounce_ms") {
      config.presses.timing.debounce_ns = milliseconds_ns(key, node, 1, 200);
    } else if (key == "button.long_ms") {
      config.presses.timing.lasting_ns = milliseconds_ns(key, node, 300, 60'000);
    } else if (key == "button.short_press") {
      config.presses.brief = meaning(key, node);
    } else if (key == "button.long_press") {
      config.presses.lasting = meaning(key, node);
    } else {
      throw Problem{line_of(node) + key +
                    " is not known; [button] has source, debounce_ms, long_ms, short_press and long_press."};
    }
  }
}

void read_volume(const toml::table& section, Config& config) {
  for (const auto& [name, node] : section) {
    const std::string key = "volume." + std::string(name.str());
    const double value = length_mm(key, node);
    if (key == "volume.r_min_mm") {
      config.volume.r_min_mm = value;
    } else if (key == "volume.r_max_mm") {
      config.volume.r_max_mm = value;
    } else if (key == "volume.z_min_mm") {
      config.volume.z_min_mm = value;
    } else if (key == "volume.z_max_mm") {
      config.volume.z_max_mm = value;
    } else {
      throw Problem{line_of(node) + key + " is not known; [volume] has r_min_mm, r_max_mm, z_min_mm and z_max_mm."};
    }
  }
}

double number(const std::string& key, const toml::node& node) {
  const auto value = node.value<double>();
  if (value && std::isfinite(*value)) return *value;
  throw Problem{line_of(node) + key + " is not a number."};
}

void read_drive(const toml::table& section, Config& config) {
  DriveConfig& drive = config.drive.emplace();
  for (const auto& [name, node] : section) {
    const std::string key = "drive." + std::string(name.str());
    if (key == "drive.profile") {
      drive.profile = text(key, node);
    } else if (key == "drive.io_profile") {
      drive.io_profile = text(key, node);
    } else if (key == "drive.io") {
      drive.io = text(key, node);
    } else if (key == "drive.serial") {
      drive.serial = text(key, node);
    } else if (key == "drive.steps_per_turn") {
      drive.steps_per_turn = number(key, node);
    } else if (key == "drive.motor_turns_per_turn") {
      drive.motor_turns_per_turn = number(key, node);
    } else if (key == "drive.max_speed_deg_per_s") {
      drive.max_speed_deg_per_s = number(key, node);
    } else if (key == "drive.max_acceleration_deg_per_s2") {
      drive.max_acceleration_deg_per_s2 = number(key, node);
    } else if (key == "drive.homing") {
      const std::string homing = text(key, node);
      if (homing != "index" && homing != "mark")
        throw Problem{line_of(node) + key + " is '" + homing + "'; write \"index\" or \"mark\"."};
      drive.homes_at_mark = homing == "mark";
    } else {
      throw Problem{line_of(node) + key +
                    " is not known; [drive] has profile, io_profile, io, serial, steps_per_turn, motor_turns_per_turn, "
                    "max_speed_deg_per_s, max_acceleration_deg_per_s2 and homing."};
    }
  }
  for (const auto& [key, value] : {std::pair{"profile", drive.profile},
                                   {"io_profile", drive.io_profile},
                                   {"io", drive.io},
                                   {"serial", drive.serial}}) {
    if (value.empty()) throw Problem{std::string("[drive] lacks ") + key + "; see firmware_bridge/DRIVE_PROFILES.md."};
  }
}

void read_motion(const toml::table& section, Config& config) {
  for (const auto& [name, node] : section) {
    const std::string key = "motion." + std::string(name.str());
    if (key == "motion.lowest_deg") {
      config.motion.lowest_deg = number(key, node);
    } else if (key == "motion.highest_deg") {
      config.motion.highest_deg = number(key, node);
    } else if (key == "motion.jerk_deg_per_s3") {
      config.motion.jerk_deg_per_s3 = number(key, node);
    } else {
      throw Problem{line_of(node) + key + " is not known; [motion] has lowest_deg, highest_deg and jerk_deg_per_s3."};
    }
  }
}

void read_calibration_limits(const toml::table& section, Config& config) {
  for (const auto& [name, node] : section) {
    const std::string key = "calibration_due." + std::string(name.str());
    const auto value = node.value_exact<std::int64_t>();
    if (key != "calibration_due.days" && key != "calibration_due.scans")
      throw Problem{line_of(node) + key + " is not known; [calibration_due] has days and scans."};
    if (!value || *value < 0 || *value > 1'000'000)
      throw Problem{line_of(node) + key + " is no whole number from 0 (never) to 1000000."};
    (key.ends_with("days") ? config.calibration_limits.days : config.calibration_limits.scans) = *value;
  }
}

void read_scan(const toml::table& section, Config& config) {
  auto json = nlohmann::json::object();
  for (const auto& [name, node] : section)
    json[std::string(name.str())] = to_json("scan." + std::string(name.str()), node);
  auto request = scan_request_from_json(json);
  if (!request) throw Problem{"in [scan] " + request.error().detail};
  config.scan = *request;
}

void read_root(const toml::table& root, Config& config) {
  for (const auto& [name, node] : root) {
    const std::string key(name.str());
    if (key == "device") {
      config.device = text(key, node);
    } else if (key == "camera") {
      config.camera = text(key, node);
    } else if (key == "calibration") {
      config.calibration = text(key, node);
    } else if (key == "calibration_due") {
      read_calibration_limits(table(key, node), config);
    } else if (key == "store") {
      config.store = text(key, node);
    } else if (key == "record") {
      config.record = text(key, node);
    } else if (key == "log_level") {
      config.log_level = text(key, node);
    } else if (key == "drive") {
      read_drive(table(key, node), config);
    } else if (key == "motion") {
      read_motion(table(key, node), config);
    } else if (key == "http") {
      read_http(table(key, node), config);
    } else if (key == "scan") {
      read_scan(table(key, node), config);
    } else if (key == "button") {
      read_button(table(key, node), config);
    } else if (key == "volume") {
      read_volume(table(key, node), config);
    } else {
      throw Problem{
          line_of(node) + "'" + key +
          "' is not known; the keys are device, camera, calibration, store, record, log_level and the sections "
          "[button], [calibration_due], [drive], [http], [motion], [scan], [volume]."};
    }
  }
}

bool starts_with_one_of(const std::string& url, std::initializer_list<const char*> schemes) {
  return std::any_of(schemes.begin(), schemes.end(), [&](const char* scheme) { return url.rfind(scheme, 0) == 0; });
}

}  // namespace

tl::expected<void, ConfigError> read_config(const std::filesystem::path& file, Config& config) {
  std::ifstream in(file, std::ios::binary);
  if (!in) {
    return tl::make_unexpected(ConfigError{"The configuration " + file.string() + " cannot be opened: " +
                                           std::strerror(errno) + "; check the name given with --config."});
  }
  std::ostringstream text;
  text << in.rdbuf();
  const auto parsed = checked_toml::parse_ascii(text.str());
  if (!parsed) {
    return tl::make_unexpected(
        ConfigError{"The configuration " + file.string() + " cannot be read, " + parsed.error() + "."});
  }
  try {
    read_root(*parsed, config);
    return {};
  } catch (const Problem& p) {
    return tl::make_unexpected(ConfigError{"The configuration " + file.string() + ", " + p.text});
  }
}

tl::expected<void, ConfigError> check_config(const Config& config) {
  const auto refused = [](const std::string& message) { return tl::make_unexpected(ConfigError{message}); };
  const bool replay = starts_with_one_of(config.camera, {"replay:"});
  if (replay && !config.device.empty()) {
    return refused("The device is '" + config.device + "', but the camera is the recording '" + config.camera +
                   "', whose frames know their angles; leave --device out.");
  }
  if (replay && !config.record.empty()) {
    return refused("The camera is the recording '" + config.camera + "' already; leave --record out.");
  }
  if (!replay && !starts_with_one_of(config.device, {"modbus-tcp://", "modbus-rtu:", "usb:"})) {
    return refused("The device is '" + config.device +
                   "'; give --device modbus-tcp://HOST[:PORT], modbus-rtu:/dev/TTY or usb:[VID:PID].");
  }
  if (config.drive && !(starts_with_one_of(config.device, {"modbus-tcp://", "modbus-rtu:"}) &&
                        starts_with_one_of(config.drive->io, {"modbus-tcp://", "modbus-rtu:"}))) {
    return refused(
        "[drive] needs the drive as device and the I/O device as io, both by modbus-tcp:// or modbus-rtu:, "
        "and they are '" +
        config.device + "' and '" + config.drive->io + "'; correct them.");
  }
  if (!starts_with_one_of(config.camera, {"v4l2:", "sim:", "replay:"})) {
    return refused("The camera is '" + config.camera +
                   "'; give --camera v4l2:/dev/videoN, v4l2:serial=NUMBER, sim:FOLDER or replay:FOLDER.");
  }
  if (!config.button.empty()) {
    if (auto button = check_button_url(config.button); !button) return refused(button.error().message);
  }
  if (replay && config.calibration.empty()) {
    return refused("The camera is the recording '" + config.camera +
                   "', which was calibrated; give its --calibration FILE.");
  }
  if (config.store.empty()) return refused("No folder for the scans is named; give --store FOLDER.");
  if (std::find(kLogLevels.begin(), kLogLevels.end(), config.log_level) == kLogLevels.end()) {
    return refused("The log level is '" + config.log_level + "'; give trace, debug, info, warn, error or off.");
  }
  const ScanVolume& v = config.volume;
  if (!(0 <= v.r_min_mm && v.r_min_mm < v.r_max_mm && v.z_min_mm < v.z_max_mm)) {
    return refused("The volume is r " + std::to_string(v.r_min_mm) + " .. " + std::to_string(v.r_max_mm) + " mm, z " +
                   std::to_string(v.z_min_mm) + " .. " + std::to_string(v.z_max_mm) +
                   " mm; give 0 <= r_min_mm < r_max_mm and z_min_mm < z_max_mm in [volume].");
  }
  return {};
}

}  // namespace celadon
