#include "tests/integration/station.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <stdexcept>

namespace celadon::testing {

using nlohmann::json;

json ask_simulator(const std::filesystem::path& folder, const std::string& request) {
  const int fd = ::socket(AF_UNIX, SOCK_STREAM, 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::snprintf(address.sun_path, sizeof address.sun_path, "%s/control.sock", folder.c_str());
  if (::connect(fd, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0)
    throw std::runtime_error("no simulator");
  const std::string line = request + "\n";
  EXPECT_EQ(::send(fd, line.data(), line.size(), MSG_NOSIGNAL), static_cast<ssize_t>(line.size()));
  std::string answer;
  for (char c = 0; ::read(fd, &c, 1) == 1 && c != '\n';) answer += c;
  ::close(fd);
  return json::parse(answer);
}

Station::Station(const std::string& scene, const std::vector<std::string>& more, Link link, Time time)
    : camera("sim:" + folder.path().string()) {
  std::vector<std::string> command = {
      "celadon-sim", "--scene", scene, "--speed", time == Time::real ? "real" : "max", "--socket-dir", folder.path()};
  if (std::find(more.begin(), more.end(), "--seed") == more.end()) command.insert(command.end(), {"--seed", "3"});
  if (link == Link::modbus_rtu) {
    command.insert(command.end(), {"--modbus-tcp", "none", "--modbus-rtu", folder / "tty"});
  } else if (link == Link::usb) {
    command.insert(command.end(), {"--modbus-tcp", "none", "--usbip=attach"});
  } else {
    command.insert(command.end(), {"--modbus-tcp", "127.0.0.1:0"});
  }
  command.insert(command.end(), more.begin(), more.end());
  simulator = std::make_unique<Program>(command);
  if (!simulator->wait_for_output("\n")) throw std::runtime_error("simulator: " + simulator->wait().err);
  url = link == Link::usb ? "usb:" : json::parse(simulator->out())["modbus_url"];
  const auto truth =
      run({"celadon-sim", "truth", "--socket-dir", folder.path(), "--calibration", folder / "calibration.toml"});
  if (truth.exit_code != 0) throw std::runtime_error("calibration: " + truth.err);
}

void Station::start_daemon(const std::vector<std::string>& more) {
  auto command = daemon_command();
  command.insert(command.end(), more.begin(), more.end());
  daemon = std::make_unique<Program>(command);
  if (!daemon->wait_for_output("\n")) throw std::runtime_error("daemon: " + daemon->wait().err);
}

std::vector<std::string> Station::daemon_command() const {
  return {"celadond",
          "--device",
          url,
          "--camera",
          camera,
          "--calibration",
          folder / "calibration.toml",
          "--store",
          folder / "store",
          "--http",
          "0",
          "--unix-socket",
          folder / "api.sock"};
}

bool laser_off(const json& state) {
  return state["lasers_on"].get<int>() == 0;
}

void expect_laser_off_within_lease(const Station& station) {
  const auto ns = [](const json& state) { return state["time_ns"].get<std::int64_t>(); };
  const json killed = station.state();
  json now = killed;
  while (!laser_off(now) && ns(now) - ns(killed) < 2'000'000'000) now = station.state();
  EXPECT_TRUE(laser_off(now)) << now;
  EXPECT_LE(ns(now) - ns(killed), 520'000'000) << "500 ms lease and one look";
}

void expect_safe(const Station& station) {
  const json now = station.state();
  EXPECT_TRUE(laser_off(now)) << now;
  EXPECT_EQ(now["motion"], "standstill") << now;
  EXPECT_EQ(now["motor_speed_rad_per_s"], 0.0) << now;
  ask_simulator(station.folder.path(),
                "wait-until " + std::to_string(now["time_ns"].get<std::int64_t>() + 1'500'000'000));
  const json later = station.state();
  EXPECT_TRUE(laser_off(later)) << later;
  EXPECT_EQ(later["speed_rad_per_s"], 0.0) << later;
  EXPECT_EQ(later["motion"], "standstill") << later;
}

}  // namespace celadon::testing
