// Calibrations by the daemon, through real processes and sockets: the API, the command line, the button, a kill.

#include <gtest/gtest.h>

#include <csignal>
#include <cstdio>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "daemon/http/http_client.h"
#include "tests/integration/held_poses.h"
#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kBoard = "tags:10x7x8";

void place(const Station& station, const std::string& scene) {
  const auto answer = ask_simulator(station.folder.path(), "scene " + scene);
  EXPECT_EQ(answer["ok"], true) << answer;
}

/// An operator who knows nothing but what the API says.
class ApiOperator {
 public:
  explicit ApiOperator(const Station& station) : station_(station), client_(station.server()) {}

  /// The calibration at its end.
  json finish(const std::string& calibration) {
    json last;
    const auto followed =
        client_.events(calibration + "/events", [&](const std::string& name, const std::string& data) {
          EXPECT_EQ(name, "calibration");
          last = json::parse(data);
          states[last["state"]] += 1;
          act(calibration, last);
          return pose_ < 5 * poses_.size();
        });
    EXPECT_TRUE(followed) << followed.error();
    return last;
  }

  std::map<std::string, int> states;  ///< seen, how often

 private:
  void act(const std::string& calibration, const json& now) {
    if (now["state"] == "paused" && now["step"] != step_) {
      step_ = now["step"].get<int>();
      const std::string instruction = now["instruction"];
      std::printf("%d. %s\n", step_, instruction.c_str());
      if (instruction.starts_with("Hold")) {
        hold();
      } else if (instruction.starts_with("Stand")) {
        place(station_, "board:" + std::string(kBoard) + placements_[placed_++ % placements_.size()]);
      } else {
        place(station_, "empty");
      }
      const auto confirmed = client_.post(calibration + "/confirm", json{{"step", step_}});
      ASSERT_TRUE(confirmed) << confirmed.error();
      EXPECT_EQ(confirmed->status, 200) << confirmed->body;
      // Once more is no step further.
      EXPECT_EQ(client_.post(calibration + "/confirm", json::object())->status, 409);
      return;
    }
    if (now["state"] != "scanning" || !now.contains("look")) return;
    const json& look = now["look"];
    const bool taken = look["views"] > views_, useless = look["found"] == false || look["known"] == true;
    views_ = look["views"].get<int>();
    // What was seen before the board moved may be told after it.
    if (!taken && (!useless || ++useless_ < 3)) return;
    useless_ = 0;
    ++pose_;
    hold();
  }
  void hold() { place(station_, "board:" + std::string(kBoard) + poses_[pose_ % poses_.size()]); }

  const Station& station_;
  HttpClient client_;
  const std::vector<std::string> poses_ = held_poses(0),
                                 placements_ = {"@0,0,55,0,-8,30", "@14,-8,55,0,10,150", "@-10,12,55,5,-12,270"};
  std::size_t pose_ = 0, placed_ = 0;
  int step_ = 0, views_ = 0, useless_ = 0;
};

json device_of(const Station& station) {
  return json::parse(HttpClient(station.server()).get("/api/v1/device")->body);
}

TEST(CalibrationJob, AMachineWithoutACalibrationIsCalibratedAndScans) {
  Station station("empty", {"--ambient", "8", "--fps", "6"});
  const std::string file = station.folder / "calibration.toml";
  fs::remove(file);
  station.start_daemon();
  EXPECT_EQ(device_of(station)["calibrated"], "");
  const std::vector<std::string> scan = {
      "celadon", "scan",   "--server", station.server(),      "--mode", "step", "--profiles",
      "60",      "--json", "-o",       station.folder / "out"};
  const auto refused = run(scan);
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_NE(refused.err.find("calibrate first: "), std::string::npos) << refused.err;

  HttpClient client(station.server());
  const auto created = client.post("/api/v1/calibrations", json{{"board", kBoard},
                                                                {"width_mm", 80},
                                                                {"height_mm", 56},
                                                                {"measured_u_mm", 0.007},
                                                                {"views", 15},
                                                                {"angles", 24}});
  ASSERT_TRUE(created) << created.error();
  ASSERT_EQ(created->status, 201) << created->body;
  ApiOperator hand(station);
  const json record = hand.finish(created->location);
  for (const json& step : record["steps"]) std::printf("%s\n", step.dump().c_str());
  ASSERT_EQ(record["state"], "done") << record["reason"];
  EXPECT_NE(record["verdict"], "refused");
  for (const char* state : {"preparing", "paused", "scanning"}) EXPECT_GT(hand.states[state], 0) << state;
  EXPECT_TRUE(fs::exists(file));
  ASSERT_TRUE(client.download(created->location + "/files/calibration.toml", station.folder / "copy.toml"));
  EXPECT_EQ(read_file(station.folder / "copy.toml"), read_file(file));
  EXPECT_NE(device_of(station)["calibrated"], "");

  place(station, "cylinder-off");
  const auto scanned = run(scan);
  ASSERT_EQ(scanned.exit_code, 0) << scanned.err;
  const json report = json::parse(read_file(station.folder / "out" / "report.json"));
  std::printf("%s\n", report["truth_mm"].dump().c_str());
  EXPECT_LT(report["truth_mm"]["rms"].get<double>(), 3 * record["values"]["systematic_mm"].get<double>());
}

TEST(CalibrationJob, WithoutAFileNamedItBelongsToTheStore) {
  Station station("empty");
  auto command = station.daemon_command();
  command.erase(command.begin() + 5, command.begin() + 7);  // --calibration FILE
  station.daemon = std::make_unique<Program>(command);
  ASSERT_TRUE(station.daemon->wait_for_output("\n")) << station.daemon->wait().err;
  EXPECT_EQ(device_of(station)["calibrated"], "");
  station.daemon->signal(SIGTERM);
  EXPECT_EQ(station.daemon->wait().exit_code, 0);
  fs::copy_file(station.folder / "calibration.toml", station.folder / "store" / "calibration.toml");
  station.daemon = std::make_unique<Program>(command);
  ASSERT_TRUE(station.daemon->wait_for_output("\n")) << station.daemon->wait().err;
  EXPECT_NE(device_of(station)["calibrated"], "");
  station.daemon->signal(SIGTERM);
  station.daemon->wait();
  // One that is there and broken is no machine that was never calibrated.
  write_file(station.folder / "store" / "calibration.toml", "[camera");
  EXPECT_EQ(run(command).exit_code, 2);
}

TEST(CalibrationJob, TheCommandLineAsksAPressOrEnterConfirmsAndCtrlCCancels) {
  Station station("empty");
  station.start_daemon();
  const std::string before = read_file(station.folder / "calibration.toml");
  const std::vector<std::string> words = {"celadon", "calibrate", "--server", station.server(),
                                          "--board", kBoard,      "-o",       station.folder / "x.toml"};
  {
    Program pressed(words, 0, Program::Input::answers);
    ASSERT_TRUE(pressed.wait_for_output("> Hold the board")) << pressed.wait().err;
    EXPECT_EQ(device_of(station)["state"], "paused");
    ask_simulator(station.folder.path(), "press");
    ASSERT_TRUE(pressed.wait_for_output("no board: ")) << pressed.wait().err;
    pressed.signal(SIGINT);
    const auto outcome = pressed.wait();
    EXPECT_EQ(outcome.exit_code, 130) << outcome.err;
    EXPECT_NE(outcome.err.find("cancelled"), std::string::npos) << outcome.err;
    expect_safe(station);
  }
  {
    Program entered(words, 0, Program::Input::answers);
    ASSERT_TRUE(entered.answer("> Hold the board", "")) << entered.wait().err;
    ASSERT_TRUE(entered.wait_for_output("no board: ")) << entered.wait().err;
    EXPECT_EQ(run({"celadon", "cancel", "2", "--server", station.server()}).exit_code, 0);
    EXPECT_EQ(entered.wait().exit_code, 1);
    expect_safe(station);
  }
  EXPECT_FALSE(fs::exists(station.folder / "x.toml"));
  EXPECT_EQ(read_file(station.folder / "calibration.toml"), before);
}

TEST(CalibrationJob, WrongWordsAreNamed) {
  const auto told = [](const std::vector<std::string>& more) {
    std::vector<std::string> words = {"celadon", "calibrate"};
    words.insert(words.end(), more.begin(), more.end());
    const auto outcome = run(words);
    EXPECT_EQ(outcome.exit_code, 2) << outcome.err;
    return outcome.err;
  };
  EXPECT_NE(told({"--server", "unix:/none", "--device", "usb:"}).find("--server names a daemon"), std::string::npos);
  EXPECT_NE(told({"--server", "unix:/none", "--width", "90"}).find("should be 120 x 84 mm"), std::string::npos);
  EXPECT_NE(told({"--device", "usb:", "--camera", "sim:/none"}).find("--output"), std::string::npos);
  const auto nobody = run({"celadon", "calibrate", "--server", "unix:/none"});
  EXPECT_EQ(nobody.exit_code, 3);
  EXPECT_NE(nobody.err.find("--device and --camera"), std::string::npos) << nobody.err;
}

/// Looks at the machine until it does something, for two minutes of its time at most.
template <class Condition>
void look_until(const Station& station, Condition condition) {
  json now = station.state();
  const auto end_ns = now["time_ns"].get<std::int64_t>() + 120'000'000'000;
  while (!condition(now) && now["time_ns"].get<std::int64_t>() < end_ns) now = station.state();
  EXPECT_TRUE(condition(now)) << now;
}

// No software of ours acts then: the controller's lease and heartbeat do.
TEST(CalibrationJob, AKilledDaemonLeavesTheMachineSafeAndSaysInterrupted) {
  Station station("empty", {"--ambient", "8", "--fps", "12"});
  HttpClient client(station.server());
  station.start_daemon();
  const json request = {{"board", kBoard}};
  ASSERT_EQ(client.post("/api/v1/calibrations", request)->status, 201);
  look_until(station, [](const json& state) { return state["motion"] == "homing"; });
  station.daemon->signal(SIGKILL);
  station.daemon->wait();
  const auto now_ns = station.state()["time_ns"].get<std::int64_t>();
  ask_simulator(station.folder.path(), "wait-until " + std::to_string(now_ns + 3'000'000'000));
  EXPECT_EQ(station.state()["motor_speed_rad_per_s"], 0.0) << station.state();

  station.start_daemon();
  const auto interrupted = json::parse(client.get("/api/v1/calibrations/1")->body);
  EXPECT_EQ(interrupted["state"], "interrupted");
  EXPECT_NE(interrupted["reason"].get<std::string>().find("nothing was changed"), std::string::npos) << interrupted;

  // Again, with the laser on a board.
  const auto created = client.post("/api/v1/calibrations", request);
  ASSERT_EQ(created->status, 201) << created->body;
  place(station, "board:" + std::string(kBoard) + held_poses(0)[8]);
  ASSERT_TRUE(client.events(created->location + "/events", [&](const std::string&, const std::string& data) {
    return json::parse(data)["state"] != "paused";
  }));
  ASSERT_EQ(client.post(created->location + "/confirm", json::object())->status, 200);
  look_until(station, [](const json& state) { return !laser_off(state); });
  station.daemon->signal(SIGKILL);
  station.daemon->wait();
  expect_laser_off_within_lease(station);
  expect_safe(station);

  station.start_daemon();
  EXPECT_EQ(json::parse(client.get(created->location)->body)["state"], "interrupted");
  place(station, "cylinder");
  EXPECT_EQ(run({"celadon", "scan", "--server", station.server(), "--profiles", "100"}).exit_code, 0);
}

}  // namespace
}  // namespace celadon::testing
