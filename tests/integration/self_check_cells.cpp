#include "tests/integration/self_check_cells.h"

#include <array>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <vector>

#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {

std::span<const CheckedObject> checked_objects() {
  static constexpr std::array<CheckedObject, 4> kObjects{{
      {"cylinder", "round, centred"},
      {"cylinder-off", "round, 6.7 mm beside the axis"},
      {"vase-squeezed", "oval"},
      {"humidifier", "freeform"},
  }};
  return kObjects;
}

std::span<const CheckedFault> checked_faults() {
  static constexpr std::array<CheckedFault, 10> kFaults{{
      {"", "none"},
      {"steps-wrong 1.01", "steps per turn wrong by 1 %"},
      {"steps-wrong 0.999", "steps per turn wrong by -0.1 %"},
      {"object-slip 2 angle 180", "object slips by 2 degrees in mid-scan"},
      {"motor-slip -2 angle 180", "table slips by -2 degrees on its drive in mid-scan"},
      {"backlash 0.5", "play of the drive of 0.5 degrees"},
      {"object-wobble 0.5", "object rocks by 0.5 mm at 3 Hz"},
      {"camera-nudge 0.2 angle 180", "camera turned by 0.2 degrees in mid-scan"},
      {"vibration 0.02", "camera shakes by 0.02 degrees at 31 Hz"},
      {"lights-on 6 angle 180", "lights six times as bright in mid-scan"},
  }};
  return kFaults;
}

std::string CheckedCell::verdict(const std::string& check) const {
  for (const auto& entry : checks)
    if (entry.value("name", "") == check) return entry.value("verdict", "");
  return "-";
}

std::string CheckedCell::names_of(const std::string& verdict) const {
  std::string names;
  for (const auto& entry : checks) {
    const std::string name = entry.value("name", "");
    if (entry.value("verdict", "") == verdict && name != "eccentricity") names += (names.empty() ? "" : " ") + name;
  }
  return names;
}

namespace {

/// The number behind `key` in the file after `from`, changed by `by`.
void change_number(std::string& file, std::size_t from, const std::string& key, double by) {
  const std::size_t at = file.find(key, from) + key.size();
  std::size_t length = 0;
  const double value = std::stod(file.substr(at, 40), &length);
  char text[40];
  std::snprintf(text, sizeof text, "%.12f", value + by);
  file.replace(at, length, text);
}

void change_calibration(const std::filesystem::path& name, const std::string& what) {
  constexpr double kMoved_mm = 0.3, kLate_ns = 4e6;
  std::string file = read_file(name);
  if (what == "laser-moved") {
    change_number(file, file.find("[[laser]]"), "distance_mm = ", kMoved_mm);
  } else if (what == "lasers-swapped") {
    const std::size_t first = file.find("number = 0"), second = file.find("number = 1");
    file.replace(first, 10, "number = 1").replace(second, 10, "number = 0");
  } else if (what == "frames-late") {
    change_number(file, file.find("[time]"), "stamp_offset_ns = { value = ", kLate_ns);
  } else {
    throw std::invalid_argument(what);
  }
  std::ofstream(name) << file;
}

}  // namespace

CheckedCell try_self_checks(const std::string& scene, const std::string& order, std::uint64_t seed, int profiles,
                            const CheckedMachine& machine) {
  std::vector<std::string> options{"--seed", std::to_string(seed), "--lasers", std::to_string(machine.lasers)};
  if (machine.datum) options.insert(options.end(), {"--rim-tags", "12"});
  Station station(scene, options);
  constexpr const char* kCalibration = "calibration ";
  const bool believed = order.starts_with(kCalibration);
  if (believed) change_calibration(station.folder / "calibration.toml", order.substr(std::strlen(kCalibration)));
  station.start_daemon();
  if (!order.empty() && !believed) ask_simulator(station.folder.path(), "fault " + order);
  const auto outcome = run({"celadon", "scan", "--server", station.server(), "--profiles", std::to_string(profiles),
                            "--formats", "surface.json", "-o", station.folder / "out"});
  CheckedCell cell{outcome.exit_code, nlohmann::json::array(), outcome.out, outcome.err};
  const auto report = nlohmann::json::parse(read_file(station.folder / "out" / "report.json"), nullptr, false);
  if (report.is_object()) cell.checks = report.value("checks", nlohmann::json::array());
  return cell;
}

}  // namespace celadon::testing
