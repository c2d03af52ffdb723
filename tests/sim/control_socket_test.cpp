#include "sim/control_socket.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <random>

namespace celadon::sim {
namespace {

using nlohmann::json;

struct Bench {
  explicit Bench(bool lock_step = true)
      : folder(std::filesystem::temp_directory_path() / ("celadon-sim-test-" + std::to_string(getpid()))),
        model([] {
          CameraConfig camera;
          camera.width_px = camera.height_px = 64;
          return default_device(camera);
        }()),
        pacer(model, lock_step) {
    std::filesystem::create_directories(folder);
    control = *ControlSocket::open(folder / "control.sock", model, pacer, "modbus-tcp://x");
  }
  ~Bench() {
    control.reset();
    std::filesystem::remove_all(folder);
  }
  json ask(const std::string& line, std::uint64_t client = 1) { return control->answer(line, client); }

  std::filesystem::path folder;
  DeviceModel model;
  Pacer pacer;
  std::unique_ptr<ControlSocket> control;
};

TEST(ControlSocket, EveryCommandOfTheDocumentAnswers) {
  Bench b;
  const json hello = b.ask("hello");
  EXPECT_TRUE(hello["ok"]);
  EXPECT_EQ(hello["version"], 1);
  EXPECT_EQ(hello["scene"], "vase");
  EXPECT_EQ(hello["lock_step"], true);
  EXPECT_EQ(hello["modbus_url"], "modbus-tcp://x");
  EXPECT_EQ(hello["machine"], b.model.machine());
  EXPECT_EQ(b.ask("time")["time_ns"], b.model.now_ns());
  EXPECT_EQ(b.ask("wait-until 1500000000")["time_ns"], 1'500'000'000);
  EXPECT_EQ(b.ask("wait-until 3")["time_ns"], 1'500'000'000);  // time does not run backwards
  EXPECT_EQ(b.ask("press")["presses"], 1);
  EXPECT_EQ(b.ask("press 50")["presses"], 2);
  const json state = b.ask("state");
  for (const char* key : {"angle_rad", "speed_rad_per_s", "motor_speed_rad_per_s", "motion", "lasers_on",
                          "lease_left_ms", "lamp", "fault", "interlock_closed", "time_ns"}) {
    EXPECT_TRUE(state.contains(key)) << key;
  }
  EXPECT_NEAR(b.ask("truth 0.5 60")["r_mm"].get<double>(), b.model.scene().truth_r_mm(0.5, 60), 1e-12);
  EXPECT_EQ(b.ask("scene")["z_max_mm"], 120.0);
  EXPECT_TRUE(parse_calibration(b.ask("calibration")["calibration"].get<std::string>(), "answer"));
  EXPECT_EQ(b.ask("fault interlock-open")["armed"], "interlock-open");
  EXPECT_EQ(b.ask("state")["interlock_closed"], false);
  EXPECT_EQ(b.ask("clear interlock-open")["cleared"], "interlock-open");
  EXPECT_EQ(b.ask("state")["interlock_closed"], true);
  EXPECT_GT(b.ask("fault list")["faults"].size(), 10U);
}

TEST(ControlSocket, AnOperatorChangesTheScene) {
  Bench b;
  EXPECT_EQ(b.ask("corners")["corners"].size(), 0u);
  const json held = b.ask("scene board:tags:6x5x9@held:0,0,60,8,-10,30");
  EXPECT_TRUE(held["ok"].get<bool>());
  EXPECT_EQ(held["name"], "board:tags:6x5x9@held:0,0,60,8,-10,30");
  EXPECT_EQ(held["time_ns"], b.model.now_ns());
  EXPECT_EQ(b.ask("scene")["name"], held["name"]);
  EXPECT_EQ(b.ask("hello")["scene"], held["name"]);
  const json corners = b.ask("corners 0.7")["corners"];
  EXPECT_EQ(corners.size(), 5u * 4);
  EXPECT_EQ(b.ask("corners")["corners"], corners);  // it does not turn with the table
  b.ask("scene board:tags:6x5x9@0,0,60,8,-10,30");
  EXPECT_NE(b.ask("corners 0.2")["corners"], corners);
  EXPECT_EQ(b.ask("corners 0")["corners"], corners);
  EXPECT_EQ(b.ask("scene cylinder")["z_max_mm"], 100.0);
  for (const char* line :
       {"scene nothing", "scene mesh:/no such file.stl", "scene board:tags@1", "corners x", "corners 1 2 3 4"}) {
    EXPECT_FALSE(b.ask(line)["ok"].get<bool>()) << line;
  }
  EXPECT_NE(b.ask("scene mesh:/no such file.stl")["error"].get<std::string>().find("/no such file.stl"),
            std::string::npos);
  EXPECT_EQ(b.ask("scene")["name"], "cylinder");
}

TEST(ControlSocket, NonsenseIsRefusedWithASentence) {
  Bench b;
  for (const std::string line : {"",
                                 " ",
                                 "Hello",
                                 "time now",
                                 "wait-until",
                                 "wait-until x",
                                 "wait-until 99999999999999999999",
                                 "wait-until 9000000000000000000",
                                 "press -1",
                                 "press nan",
                                 "press 1 2",
                                 "truth",
                                 "truth 1",
                                 "truth a b",
                                 "truth inf 3",
                                 "truth 0 500",
                                 "fault",
                                 "fault nix",
                                 "fault drop-frame 1 2",
                                 "clear nix",
                                 "clear",
                                 "state x",
                                 "\x01\xff\x80 binary",
                                 "hello\r",
                                 "wait-until 1e9"}) {
    const json answer = b.ask(line);
    EXPECT_FALSE(answer["ok"].get<bool>()) << line;
    EXPECT_GT(answer["error"].get<std::string>().size(), 10U) << line;
  }
}

TEST(ControlSocket, WaitingIsForLockStep) {
  Bench b(false);
  EXPECT_FALSE(b.ask("wait-until 1")["ok"].get<bool>());
}

TEST(ControlSocket, TimeStandsStillBetweenDeclaredWaits) {
  Bench b;
  const std::int64_t now = b.model.now_ns();
  EXPECT_TRUE(b.pacer.holds());
  b.ask("state");
  EXPECT_EQ(b.model.now_ns(), now);
  b.ask("wait-until " + std::to_string(now + 1000), 7);
  b.ask("wait-until " + std::to_string(now + 2000), 8);
  b.pacer.forget(7);
  EXPECT_TRUE(b.pacer.holds());
  b.pacer.forget(8);
  EXPECT_FALSE(b.pacer.holds());  // runs on in real time
  b.ask("wait-until " + std::to_string(now + 3000), 9);
  EXPECT_TRUE(b.pacer.holds());
}

TEST(ControlSocket, RandomLinesNeverHarm) {
  Bench b;
  std::mt19937 random(9);
  const std::vector<std::string> words{"hello",    "time",       "wait-until", "press", "state",          "truth",
                                       "scene",    "fault",      "clear",      "list",  "drop-frame",     "-1",
                                       "1e308",    "nan",        "0",          "7",     "interlock-open", "",
                                       "\xff\xfe", "modbus-late"};
  for (int i = 0; i < 1500; ++i) {
    std::string line;
    for (std::size_t n = random() % 5; n > 0; --n) line += words[random() % words.size()] + " ";
    if (random() % 4 == 0) line += std::string(random() % 50, static_cast<char>(random()));
    EXPECT_TRUE(b.ask(line).contains("ok"));
  }
}

}  // namespace
}  // namespace celadon::sim
