// What a stranger may do to the programs: one sentence with the remedy, the right exit code, nothing half done, and a
// machine that is dark and stands.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <csignal>
#include <nlohmann/json.hpp>

#include "tests/firmware_bridge/modbus_machine.h"
#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using ::testing::HasSubstr;

constexpr int kNo = 1, kUsage = 2, kDevice = 3, kSystem = 4, kInterrupted = 130;

// Exit code, and one line that begins with the program's name and holds all of `parts`.
void expect_refusal(const std::vector<std::string>& command, int exit_code, const std::vector<std::string>& parts) {
  const auto outcome = run(command);
  std::string words;
  for (const auto& word : command) words += word + " ";
  SCOPED_TRACE(words);
  EXPECT_EQ(outcome.exit_code, exit_code) << outcome.err;
  EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
  EXPECT_EQ(outcome.err.rfind(command[0] + ": ", 0), 0u) << outcome.err;
  for (const auto& part : parts) EXPECT_THAT(outcome.err, HasSubstr(part));
}

TEST(BadInput, WrongOptionsAreNamedWithTheHelpThatExplainsThem) {
  const std::string negative = "'-1' must be a finite number, 0 or more";
  expect_refusal({"celadon", "fit", "a.xyz", "--tolerance", "-1"}, kUsage,
                 {"--tolerance", negative, "celadon fit --help"});
  expect_refusal({"celadon", "fit", "a.xyz", "--tolerance", "nan"}, kUsage, {"--tolerance", "'nan'"});
  expect_refusal({"celadon", "fit", "a.xyz", "--form-tolerance", "inf"}, kUsage, {"--form-tolerance", "'inf'"});
  expect_refusal({"celadon", "scan", "--exposure", "-1"}, kUsage, {"--exposure", negative, "celadon scan --help"});
  expect_refusal({"celadon", "scan", "--simulate", "teapot"}, kUsage, {"teapot", "vase", "celadon scan --help"});
  expect_refusal({"celadon", "fit", "a.xyz", "--bogus"}, kUsage, {"--bogus", "celadon fit --help"});
  expect_refusal({"celadon", "fit"}, kUsage, {"INPUT", "celadon fit --help"});
  expect_refusal({"celadon", "bogus"}, kUsage, {"'bogus' is not a command", "celadon --help"});
  expect_refusal({"celadon"}, kUsage, {"celadon --help"});
  expect_refusal({"celadond", "--http", "99999"}, kUsage, {"--http", "99999", "celadond --help"});
  expect_refusal({"celadon-sim", "--scene", "teapot"}, kUsage, {"teapot", "celadon-sim --help"});
}

TEST(BadInput, FilesThatAreNoneAreNamed) {
  const TemporaryFolder folder;
  const auto cloud = folder.write("cloud.xyz", "10 0 5\n");
  expect_refusal({"celadon", "evaluate", cloud}, kUsage, {cloud, "not JSON", "byte", "surface.json"});
  expect_refusal({"celadond", "--config", folder / "none.toml"}, kUsage,
                 {folder / "none.toml", "No such file", "--config"});
  expect_refusal({"celadond", "--camera", "replay:" + (folder / "none").string(), "--calibration", cloud, "--store",
                  folder / "store"},
                 kUsage, {cloud, "line 1"});
  expect_refusal({"celadond", "--device", "modbus-tcp://127.0.0.1", "--camera", "replay:" + (folder / "a").string()},
                 kUsage, {"leave --device out"});
  expect_refusal({"celadon-sim", "frame", "--width", "64", "--height", "64", "-o", folder / "none" / "a.png"}, kSystem,
                 {"No such file", "choose another folder"});
}

// The daemon does not wait for a machine that cannot come.
TEST(BadInput, AddressesThatCannotBeAMachineEndTheDaemon) {
  Station station;
  auto command = station.daemon_command();
  for (const auto& [url, part] :
       {std::pair{"usb:1234:5678/", "serial number"}, std::pair{"modbus-tcp://127.0.0.1:99999", "port"},
        std::pair{"modbus-rtu:", "/dev/ttyX"}}) {
    command[2] = url;
    const auto outcome = run(command);
    EXPECT_EQ(outcome.exit_code, kUsage) << outcome.err;
    EXPECT_THAT(outcome.err, HasSubstr(part));
  }
}

TEST(BadInput, AHostThatIsNotKnownIsNotCalledOneThatRefuses) {
  Station station;
  auto command = station.daemon_command();
  command[2] = "modbus-tcp://no-such-host.invalid";
  station.daemon = std::make_unique<Program>(command);
  ASSERT_TRUE(station.daemon->wait_for_output("\n"));
  expect_refusal({"celadon", "scan", "--server", station.server()}, kDevice,
                 {"no-such-host.invalid", "is not known", "address"});
}

TEST(BadInput, AMachineOfAnotherProtocolVersionEndsTheDaemon) {
  Station station;
  ControllerConfig config = test::test_config();
  config.protocol_major = 2;
  test::Machine machine(config);
  test::ModbusServer server(machine, test::ModbusServer::Link::tcp);
  auto command = station.daemon_command();
  command[2] = server.url("timeout_ms=2000");
  const auto outcome = run(command);
  EXPECT_EQ(outcome.exit_code, kUsage) << outcome.err;
  EXPECT_THAT(outcome.err, HasSubstr("2."));
  EXPECT_THAT(outcome.err, HasSubstr("1."));
  EXPECT_THAT(outcome.err, HasSubstr("protocol"));
}

TEST(BadInput, ADiskThatFillsDuringAScanIsTheSystemsFault) {
  Station station;
  station.daemon = std::make_unique<Program>(station.daemon_command(), 400'000);  // bytes a file may have
  ASSERT_TRUE(station.daemon->wait_for_output("\n"));
  expect_refusal({"celadon", "scan", "--server", station.server(), "--profiles", "100", "-o", station.folder / "out"},
                 kSystem, {"profiles.log", "File too large", "free space"});
  expect_safe(station);
  EXPECT_TRUE(fs::is_empty(station.folder / "out"));
  for (const auto& entry : fs::recursive_directory_iterator(station.folder / "store")) {
    EXPECT_NE(entry.path().filename(), "results") << entry.path();
    EXPECT_NE(entry.path().filename(), "results.part") << entry.path();
  }
}

TEST(BadInput, ADeadLaserIsNamedAndTheMachineLeftSafe) {
  Station station;
  station.start_daemon();
  ask_simulator(station.folder.path(), "fault laser-dead");
  expect_refusal({"celadon", "scan", "--server", station.server()}, kDevice, {"Laser 0 does not emit", "check"});
  expect_safe(station);
}

TEST(BadInput, CtrlCOfASimulatedScanLeavesNothing) {
  const TemporaryFolder folder;
  Program scan({"celadon", "scan", "--simulate", "vase", "--profiles", "4000", "--json", "-o", folder / "out"});
  ASSERT_TRUE(scan.wait_for_output("\"state\":\"scanning\""));
  scan.signal(SIGINT);
  const auto outcome = scan.wait();
  EXPECT_EQ(outcome.exit_code, kInterrupted) << outcome.err;
  EXPECT_TRUE(fs::is_empty(folder / "out"));
}

TEST(BadInput, ARecordingThatEndsEarlyOrShowsNothingIsTold) {
  const TemporaryFolder folder;
  const auto truth =
      run({"celadon-sim", "truth", "--width", "64", "--height", "64", "--calibration", folder / "c.toml"});
  ASSERT_EQ(truth.exit_code, 0) << truth.err;
  std::string camera = read_file(folder / "c.toml");
  camera = camera.substr(camera.find("camera = \"") + 10);
  camera = camera.substr(0, camera.find('"'));
  fs::create_directory(folder / "dark");
  folder.write("dark/a.pgm", "P5\n64 64\n255\n" + std::string(64 * 64, '\7'));
  folder.write("dark/index.csv", "celadon-recording,1.0\ncamera," + camera +
                                     "\nfile,table_angle_deg,stamp_ns,exposure_ns,laser\na.pgm,0,0,0,1\n");
  Program daemon({"celadond", "--camera", "replay:" + (folder / "dark").string(), "--calibration", folder / "c.toml",
                  "--store", folder / "store", "--http", "0", "--unix-socket", folder / "api.sock"});
  ASSERT_TRUE(daemon.wait_for_output("\n")) << daemon.wait().err;
  const auto outcome = run({"celadon", "scan", "--server", "unix:" + (folder / "api.sock").string()});
  EXPECT_EQ(outcome.exit_code, kDevice) << outcome.err;
  EXPECT_THAT(outcome.err, HasSubstr("No laser line is seen in frame 0 of the recording"));
}

// Frames that show one place only: measured well, but no surface.
TEST(BadInput, ARecordingOfOnePlaceGivesTheAnswerNo) {
  Station station;
  station.start_daemon({"--record", station.folder / "frames"});
  const auto live = run({"celadon", "scan", "--server", station.server(), "--mode", "step", "--profiles", "16"});
  ASSERT_EQ(live.exit_code, 0) << live.err;
  station.daemon->signal(SIGTERM);
  station.daemon->wait();
  const fs::path index = station.folder / "frames" / "1" / "index.csv";
  std::string text = read_file(index);
  std::size_t turns = 0;
  std::string cut;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = text.find('\n', at) + 1;
    const std::string line = text.substr(at, end - at);
    const bool of_turn = line.find(",turn,") != std::string::npos || line.find(",overlap,") != std::string::npos;
    if (!of_turn || turns++ == 0) cut += line;
    at = end;
  }
  ASSERT_GT(turns, 16u);
  write_file(index, cut);
  station.daemon = std::make_unique<Program>(
      std::vector<std::string>{"celadond", "--camera", "replay:" + index.parent_path().string(), "--calibration",
                               station.folder / "calibration.toml", "--store", station.folder / "again", "--http", "0",
                               "--unix-socket", station.folder / "api.sock"});
  ASSERT_TRUE(station.daemon->wait_for_output("\n")) << station.daemon->wait().err;
  expect_refusal({"celadon", "scan", "--server", station.server()}, kNo, {"No surface was found"});
}

}  // namespace
}  // namespace celadon::testing
