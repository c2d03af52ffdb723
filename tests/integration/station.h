#pragma once
// A virtual scanner and a daemon that drives it, as real processes; what is said of the machine is the simulator's.

#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/integration/process.h"

namespace celadon::testing {

/// One request to the control socket of the virtual scanner in a folder (sim/CONTROL.md).
nlohmann::json ask_simulator(const std::filesystem::path& folder, const std::string& request);

class Station {
 public:
  /// usb: in this machine's kernel, camera too; as root, with vhci-hcd
  enum class Link { modbus_tcp, modbus_rtu, usb };

  enum class Time { lock_step, real };

  /// Starts the simulator and writes its true calibration. `more`: further words of its command line.
  explicit Station(const std::string& scene = "vase", const std::vector<std::string>& more = {},
                   Link link = Link::modbus_tcp, Time time = Time::lock_step);
  /// Blocks until the daemon serves. `more`: further words of its command line.
  void start_daemon(const std::vector<std::string>& more = {});
  std::vector<std::string> daemon_command() const;
  std::string server() const { return "unix:" + (folder / "api.sock").string(); }
  nlohmann::json state() const { return ask_simulator(folder.path(), "state"); }

  TemporaryFolder folder;
  std::string url;     ///< of the device
  std::string camera;  ///< that daemons are given; the simulator's unless changed
  std::unique_ptr<Program> simulator, daemon;
};

bool laser_off(const nlohmann::json& state);
/// After the daemon was killed: the laser goes off within its lease of 500 ms of device time, by itself.
void expect_laser_off_within_lease(const Station& station);
/// Laser off, motor at speed 0 and the drive at standstill, now; and the table itself, which swings on its coupling for
/// a moment longer, at speed 0 after a second and a half of device time.
void expect_safe(const Station& station);

}  // namespace celadon::testing
