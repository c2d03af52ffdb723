// Whole scans through real processes and real sockets: virtual scanner, daemon, command line. What is asserted about
// time is device time, read from the surviving simulator.

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "tests/integration/process.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// One request to the control socket of a virtual scanner.
json ask_simulator(const fs::path& folder, const std::string& request) {
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

// A virtual scanner and a daemon that drives it.
class Station {
 public:
  explicit Station(const std::string& speed = "max", const std::vector<std::string>& more = {}) {
    std::vector<std::string> command = {"celadon-sim", "--scene",      "vase",       "--seed",
                                        "3",           "--speed",      speed,        "--modbus-tcp",
                                        "127.0.0.1:0", "--socket-dir", folder.path()};
    command.insert(command.end(), more.begin(), more.end());
    simulator = std::make_unique<Program>(command);
    if (!simulator->wait_for_output("\n")) throw std::runtime_error("simulator: " + simulator->wait().err);
    url = json::parse(simulator->out())["modbus_url"];
    const auto truth =
        run({"celadon-sim", "truth", "--socket-dir", folder.path(), "--calibration", folder / "calibration.toml"});
    if (truth.exit_code != 0) throw std::runtime_error("calibration: " + truth.err);
  }
  void start_daemon() {
    daemon = std::make_unique<Program>(daemon_command());
    if (!daemon->wait_for_output("\n")) throw std::runtime_error("daemon: " + daemon->wait().err);
  }
  std::vector<std::string> daemon_command() const {
    return {"celadond",
            "--device",
            url,
            "--camera",
            "sim:" + folder.path().string(),
            "--calibration",
            folder / "calibration.toml",
            "--store",
            folder / "store",
            "--http",
            "0",
            "--unix-socket",
            folder / "api.sock"};
  }
  std::string server() const { return "unix:" + (folder / "api.sock").string(); }
  json state() const { return ask_simulator(folder.path(), "state"); }

  TemporaryFolder folder;
  std::string url;
  std::unique_ptr<Program> simulator, daemon;
};

bool laser_off(const json& state) {
  return state["lasers_on"].get<int>() == 0;
}

// The drive stands; the table on its belt may still swing by less than a milliradian a second.
bool motor_stopped(const json& state) {
  return state["motion"] != "moving" && state["motion"] != "homing" &&
         std::abs(state["speed_rad_per_s"].get<double>()) < 2e-3;
}

// Follows `celadon watch --json` until a scan delivers frames.
void wait_for_frames(Program& watch) {
  const std::string scanning = "\"state\":\"scanning\"";
  ASSERT_TRUE(watch.wait_for_output(scanning)) << watch.wait().err;
}

TEST(Scan, VaseBecomesARevolutionSolidCloseToTheTruth) {
  const TemporaryFolder folder;
  const auto outcome =
      run({"celadon", "scan", "--simulate", "vase", "--profiles", "400", "-o", folder / "out", "--json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json report = json::parse(read_file(folder / "out" / "report.json"));
  EXPECT_EQ(report["simulated"], true);
  EXPECT_EQ(report["model"], "revolution");
  EXPECT_EQ(report["solid"]["valid"], true);
  EXPECT_GT(report["solid"]["volume_mm3"], 0.0);
  EXPECT_LT(report["truth_mm"]["rms"], 0.02);
  EXPECT_LT(std::abs(report["truth_mm"]["bias"].get<double>()), 0.01);
  for (const char* file : {"vase.step", "vase.stl", "vase.ply", "surface.json", "report.json"}) {
    EXPECT_TRUE(fs::exists(folder / "out" / file)) << file;
  }
  const std::string step = read_file(folder / "out" / "vase.step");
  EXPECT_NE(step.substr(0, 2000).find("simulated"), std::string::npos);
}

TEST(Scan, StepModeSeesTheSameObject) {
  const TemporaryFolder folder;
  const auto outcome =
      run({"celadon", "scan", "--simulate", "cylinder", "--mode", "step", "--profiles", "72", "-o", folder / "out"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json report = json::parse(read_file(folder / "out" / "report.json"));
  EXPECT_EQ(report["model"], "cylinder") << report["decided_by"];
  EXPECT_LT(report["truth_mm"]["max"], 0.05);
}

TEST(Scan, SqueezedVaseIsGeneral) {
  const TemporaryFolder folder;
  const auto outcome =
      run({"celadon", "scan", "--simulate", "vase-squeezed", "--profiles", "400", "-o", folder / "out"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json report = json::parse(read_file(folder / "out" / "report.json"));
  EXPECT_EQ(report["model"], "general");
  EXPECT_EQ(report["degree"], json({3, 5}));
  EXPECT_LT(report["truth_mm"]["rms"], 0.03);
}

TEST(Scan, ButtonStartsOneAndASecondPressEndsIt) {
  Station station;
  station.start_daemon();
  Program watch({"celadon", "watch", "--server", station.server(), "--json"});
  ask_simulator(station.folder.path(), "press");
  wait_for_frames(watch);
  EXPECT_NE(watch.out().find("\"requested_by\":\"button\""), std::string::npos);
  ask_simulator(station.folder.path(), "press");
  const auto outcome = watch.wait();
  EXPECT_EQ(outcome.exit_code, 1) << outcome.err;
  EXPECT_NE(outcome.out.find("\"state\":\"cancelled\""), std::string::npos) << outcome.err;
  EXPECT_TRUE(laser_off(station.state()));
  EXPECT_TRUE(motor_stopped(station.state())) << station.state();
}

TEST(Scan, CtrlCEndsTheScanWithLaserOffAndMotorStopped) {
  Station station;
  station.start_daemon();
  Program scan({"celadon", "scan", "--server", station.server(), "--json", "-o", station.folder / "out"});
  wait_for_frames(scan);
  scan.signal(SIGINT);
  const auto outcome = scan.wait();
  EXPECT_EQ(outcome.exit_code, 130) << outcome.err;
  EXPECT_TRUE(laser_off(station.state()));
  EXPECT_TRUE(motor_stopped(station.state())) << station.state();
  EXPECT_TRUE(fs::is_empty(station.folder / "out"));
}

TEST(Scan, TerminatedDaemonMakesSafe) {
  Station station;
  station.start_daemon();
  Program scan({"celadon", "scan", "--server", station.server(), "--json"});
  wait_for_frames(scan);
  station.daemon->signal(SIGTERM);
  EXPECT_EQ(station.daemon->wait().exit_code, 0);
  EXPECT_TRUE(laser_off(station.state()));
  EXPECT_TRUE(motor_stopped(station.state())) << station.state();
  EXPECT_NE(scan.wait().exit_code, 0);
}

// The kernel closes the daemon's sockets, the device runs on, and its lease ends the laser: no software of ours acts.
TEST(Scan, KilledDaemonLeavesTheLaserOffWithinTheLease) {
  Station station;
  station.start_daemon();
  Program scan({"celadon", "scan", "--server", station.server(), "--json"});
  wait_for_frames(scan);
  station.daemon->signal(SIGKILL);
  station.daemon->wait();
  const json killed = station.state();
  const std::int64_t begin_ns = killed["time_ns"];
  json now = killed;
  while (!laser_off(now) && now["time_ns"].get<std::int64_t>() - begin_ns < 2'000'000'000) now = station.state();
  EXPECT_TRUE(laser_off(now));
  EXPECT_LE(now["time_ns"].get<std::int64_t>() - begin_ns, 520'000'000) << "500 ms lease and one look";
  scan.wait();

  // A new daemon makes safe first, reports the scan as interrupted, and scans again.
  station.start_daemon();
  const auto status = run({"celadon", "status", "--server", station.server()});
  EXPECT_NE(status.out.find("interrupted"), std::string::npos) << status.out;
  const auto again =
      run({"celadon", "scan", "--server", station.server(), "--profiles", "100", "-o", station.folder / "again"});
  EXPECT_EQ(again.exit_code, 0) << again.err;
}

TEST(Scan, SameSeedGivesTheSameSurface) {
  const TemporaryFolder folder;
  for (const char* name : {"a", "b"}) {
    const auto outcome =
        run({"celadon", "scan", "--simulate", "humidifier", "--profiles", "120", "--seed", "9", "-o", folder / name});
    ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  }
  const json a = json::parse(read_file(folder / "a" / "surface.json")),
             b = json::parse(read_file(folder / "b" / "surface.json"));
  EXPECT_EQ(a["surface"], b["surface"]);
}

TEST(Daemon, AbsentDeviceAndForeignCalibrationAreNamed) {
  Station station;
  auto command = station.daemon_command();
  command[2] = "modbus-tcp://127.0.0.1:1";
  Program absent(command);
  ASSERT_TRUE(absent.wait_for_output("\n"));  // it runs on and says so
  const auto status = run({"celadon", "status", "--server", station.server()});
  EXPECT_NE(status.out.find("127.0.0.1:1"), std::string::npos) << status.out;
  absent.signal(SIGTERM);
  absent.wait();

  std::string foreign = read_file(station.folder / "calibration.toml");
  const auto machine = foreign.find("machine = \"");
  ASSERT_NE(machine, std::string::npos);
  foreign.insert(machine + 11, "Other ");
  station.folder.write("foreign.toml", foreign);
  command = station.daemon_command();
  command[6] = station.folder / "foreign.toml";
  const auto outcome = run(command);
  EXPECT_EQ(outcome.exit_code, 2) << outcome.err;
  EXPECT_NE(outcome.err.find("Other "), std::string::npos) << outcome.err;
}

TEST(Daemon, WrongOptionsAreRefused) {
  EXPECT_EQ(run({"celadond", "--device", "smoke-signals:hill"}).exit_code, 2);
  EXPECT_EQ(run({"celadond", "--bogus"}).exit_code, 2);
  EXPECT_EQ(run({"celadon-sim", "--scene", "teapot"}).exit_code, 2);
  EXPECT_EQ(run({"celadon", "scan", "--profiles", "3"}).exit_code, 2);
  const auto nobody = run({"celadon", "scan", "--server", "http://127.0.0.1:1"});
  EXPECT_EQ(nobody.exit_code, 3);
  EXPECT_NE(nobody.err.find("127.0.0.1:1"), std::string::npos) << nobody.err;
}

}  // namespace
}  // namespace celadon::testing
