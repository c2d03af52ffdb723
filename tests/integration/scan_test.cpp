// Whole scans through real processes and real sockets: virtual scanner, daemon, command line. What is asserted about
// time is device time, read from the surviving simulator.

#include <gtest/gtest.h>

#include <cmath>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// Follows `celadon watch --json` until a scan delivers frames.
void wait_for_frames(Program& watch) {
  const std::string scanning = "\"state\":\"scanning\"";
  ASSERT_TRUE(watch.wait_for_output(scanning)) << watch.wait().err;
}

// Payloads of the profiles (types 3 and 4) in the first scan's log of a store (daemon/PROFILE_LOG.md).
std::string profiles_of(const fs::path& store) {
  std::string profiles;
  for (const auto& entry : fs::recursive_directory_iterator(store)) {
    if (entry.path().filename() != "profiles.log") continue;
    const std::string log = read_file(entry.path());
    const auto u32 = [&](std::size_t at) {
      std::uint32_t value = 0;
      std::memcpy(&value, log.data() + at, sizeof value);
      return value;
    };
    for (std::size_t at = 16; at + 24 <= log.size();) {
      const std::uint32_t type = u32(at + 4) & 0xffff, length = u32(at + 8);
      if (type == 3 || type == 4) profiles += log.substr(at + 24, length);
      at += 24 + (length + 7) / 8 * 8;
    }
  }
  return profiles;
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
  for (const char* file : {"vase.step", "vase.stl", "vase.ply", "surface.json", "errors.svg", "report.json"}) {
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
  const json& diameter = report["dimensions"][0];
  EXPECT_NEAR(diameter["value"].get<double>(), 60, 3 * diameter["standard_uncertainty"].get<double>());
  EXPECT_GT(diameter["standard_uncertainty"], 0.002);
  EXPECT_LT(diameter["standard_uncertainty"], 0.03);
}

TEST(Scan, SCurvesSeeTheSameObjectAndSoftLimitsEndAScanBeforeItTurns) {
  Station station("cylinder");
  const auto gentle = station.folder.write("gentle.toml", "[motion]\njerk_deg_per_s3 = 4000\nhighest_deg = 4000\n");
  station.start_daemon({"--config", gentle});
  const std::vector<std::string> words = {
      "celadon", "scan", "--server", station.server(), "-o", station.folder / "out", "--profiles", "200"};
  const auto outcome = run(words);
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json report = json::parse(read_file(station.folder / "out" / "report.json"));
  EXPECT_EQ(report["model"], "cylinder") << report["decided_by"];
  EXPECT_LT(report["truth_mm"]["max"], 0.05);

  const auto tight = station.folder.write("tight.toml", "[motion]\nhighest_deg = 90\n");
  station.daemon.reset();
  station.start_daemon({"--config", tight});
  const auto refused = run(words);
  EXPECT_EQ(refused.exit_code, 3) << refused.err;
  EXPECT_NE(refused.err.find("beyond the soft limit of 90.000 deg"), std::string::npos) << refused.err;
}

// The cylinder stands at (6, 3): about the table's axis it would be a general surface of many control points.
TEST(Scan, APartOffTheAxisIsWhatItIsAboutItsOwn) {
  const TemporaryFolder folder;
  const auto outcome =
      run({"celadon", "scan", "--simulate", "cylinder-off", "--profiles", "200", "-o", folder / "out"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json report = json::parse(read_file(folder / "out" / "report.json"));
  EXPECT_EQ(report["model"], "cylinder") << report["decided_by"];
  EXPECT_EQ(report["control_points"], json({2, 9}));
  EXPECT_NEAR(report["frame"]["origin"][0].get<double>(), 6, 0.02);
  EXPECT_NEAR(report["frame"]["origin"][1].get<double>(), 3, 0.02);
  EXPECT_NE(report["about_scanner_axis"]["model"], "cylinder");
  EXPECT_LT(report["truth_mm"]["max"], 0.05);
  EXPECT_NE(outcome.out.find("about the scanner's axis it would be"), std::string::npos) << outcome.out;
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
  expect_safe(station);
}

TEST(Scan, CtrlCEndsTheScanWithLaserOffAndMotorStopped) {
  Station station;
  station.start_daemon();
  Program scan({"celadon", "scan", "--server", station.server(), "--json", "-o", station.folder / "out"});
  wait_for_frames(scan);
  scan.signal(SIGINT);
  const auto outcome = scan.wait();
  EXPECT_EQ(outcome.exit_code, 130) << outcome.err;
  expect_safe(station);
  EXPECT_TRUE(fs::is_empty(station.folder / "out"));
}

TEST(Scan, TerminatedDaemonMakesSafe) {
  Station station;
  station.start_daemon();
  Program scan({"celadon", "scan", "--server", station.server(), "--json"});
  wait_for_frames(scan);
  station.daemon->signal(SIGTERM);
  EXPECT_EQ(station.daemon->wait().exit_code, 0);
  expect_safe(station);
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
  expect_laser_off_within_lease(station);
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

/// The check of the report, or its absence.
json check_in(const json& report, const std::string& name) {
  for (const json& check : report["checks"]) {
    if (check["name"] == name) return check;
  }
  return {{"verdict", "absent"}};
}

// Samples and files of a recorded scan are those of the scan itself, to the last bit: same pixels, same background,
// same angle for each frame; the date is the scan's. In steps a lamp goes on in between, and the background is renewed.
TEST(Replay, GivesTheBytesOfTheRecordedScan) {
  for (const char* shutter : {"global", "rolling"}) {
    for (const char* mode : {"sweep", "step"}) {
      Station station("vase", {"--width", "640", "--height", "512", "--shutter", shutter});
      station.start_daemon({"--record", station.folder / "frames"});
      const std::vector<std::string> request = {"--profiles", "48", "--mode", mode, "--name", "vase"};
      const auto scan = [&](const std::string& out) {
        std::vector<std::string> command = {"celadon",        "scan", "--server",
                                            station.server(), "-o",   station.folder / out};
        command.insert(command.end(), request.begin(), request.end());
        const auto outcome = run(command);
        ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
      };
      const bool steps = std::string(mode) == "step";
      if (steps) ask_simulator(station.folder.path(), "fault lights-on 6 angle 120");
      scan("live");
      if (steps) {
        const json room = check_in(json::parse(read_file(station.folder / "live" / "report.json")), "room_light");
        EXPECT_EQ(room["verdict"], "passed") << room;
        EXPECT_NE(room["note"].get<std::string>().find("looked at again"), std::string::npos) << room;
      }
      station.daemon->signal(SIGTERM);
      ASSERT_EQ(station.daemon->wait().exit_code, 0);
      // No machine is left: what follows comes from the files.
      station.simulator->signal(SIGTERM);
      station.simulator->wait();

      station.daemon = std::make_unique<Program>(std::vector<std::string>{
          "celadond", "--camera", "replay:" + (station.folder / "frames" / "1").string(), "--calibration",
          station.folder / "calibration.toml", "--store", station.folder / "again", "--http", "0", "--unix-socket",
          station.folder / "api.sock"});
      ASSERT_TRUE(station.daemon->wait_for_output("\n")) << station.daemon->wait().err;
      scan("replayed");
      for (const char* file : {"vase.step", "vase.stl", "vase.ply", "surface.json"}) {
        const std::string live = read_file(station.folder / "live" / file);
        EXPECT_FALSE(live.empty());
        EXPECT_TRUE(live == read_file(station.folder / "replayed" / file)) << file << ", " << mode << ", " << shutter;
      }
      const std::string live = profiles_of(station.folder / "store"), again = profiles_of(station.folder / "again");
      EXPECT_GT(live.size(), 48u * 100 * 24);
      EXPECT_TRUE(live == again) << mode << ", " << shutter;
      EXPECT_EQ(json::parse(read_file(station.folder / "replayed" / "report.json"))["simulated"], true);
    }
  }
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
