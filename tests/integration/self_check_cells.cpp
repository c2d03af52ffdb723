#include "tests/integration/self_check_cells.h"

#include <array>

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
  static constexpr std::array<CheckedFault, 9> kFaults{{
      {"", "none"},
      {"steps-wrong 1.01", "steps per turn wrong by 1 %"},
      {"steps-wrong 0.999", "steps per turn wrong by -0.1 %"},
      {"object-slip 2 angle 180", "object slips by 2 degrees in mid-scan"},
      {"motor-slip -2 angle 180", "table slips by -2 degrees on its drive in mid-scan"},
      {"backlash 0.5", "play of the drive of 0.5 degrees"},
      {"object-wobble 0.5", "object rocks by 0.5 mm at 3 Hz"},
      {"camera-nudge 0.2 angle 180", "camera turned by 0.2 degrees in mid-scan"},
      {"vibration 0.02", "camera shakes by 0.02 degrees at 31 Hz"},
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

CheckedCell try_self_checks(const std::string& scene, const std::string& order, std::uint64_t seed, int profiles) {
  Station station(scene, {"--seed", std::to_string(seed)});
  station.start_daemon();
  if (!order.empty()) ask_simulator(station.folder.path(), "fault " + order);
  const auto outcome = run({"celadon", "scan", "--server", station.server(), "--profiles", std::to_string(profiles),
                            "--formats", "surface.json", "-o", station.folder / "out"});
  CheckedCell cell{outcome.exit_code, nlohmann::json::array(), outcome.out, outcome.err};
  const auto report = nlohmann::json::parse(read_file(station.folder / "out" / "report.json"), nullptr, false);
  if (report.is_object()) cell.checks = report.value("checks", nlohmann::json::array());
  return cell;
}

}  // namespace celadon::testing
