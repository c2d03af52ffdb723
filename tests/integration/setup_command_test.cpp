// celadon setup, answered as an operator would: on the virtual scanner, with a calibration that is there already.

#include <gtest/gtest.h>

#include <csignal>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;

class SetupCommand : public ::testing::Test {
 protected:
  SetupCommand() { fs::create_directories(machine_); }
  void keep_calibration() { fs::copy_file(station_.folder / "calibration.toml", machine_ + "/scanner.toml"); }
  Program start() {
    return Program({"celadon", "setup", "--camera", station_.camera, "-o", machine_}, 0, Program::Input::answers);
  }
  void put(const std::string& scene) const { ask_simulator(station_.folder.path(), "scene " + scene); }

  Station station_{"empty", {"--width", "640", "--height", "512"}};
  std::string machine_ = (station_.folder / "machine").string();
};

TEST_F(SetupCommand, LeadsToAScan) {
  keep_calibration();
  Program setup = start();
  ASSERT_TRUE(setup.answer("Its address?", "modbus-tcp://127.0.0.1:1")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Try again?", "perhaps")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Answer y or n.", "y"));
  ASSERT_TRUE(setup.answer("Its address?", station_.url));
  ASSERT_TRUE(setup.answer("Take everything off the table", ""));
  // Nothing stands there yet.
  ASSERT_TRUE(setup.answer("Stand something bright", "")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("less than a fifth of the picture", "y"));
  put("cylinder");
  ASSERT_TRUE(setup.answer("Watch the table", "")) << setup.wait().err;
  const double before = station_.state()["angle_rad"].get<double>();
  ASSERT_TRUE(setup.answer("Did it turn", "again")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Did it turn", "ccw"));
  EXPECT_GT(station_.state()["angle_rad"].get<double>(), before + 0.5);
  ASSERT_TRUE(setup.answer("Keep it?", "y")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("known size", "cylinder:D=60,u=0.002")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("first scan", "")) << setup.wait().err;
  const auto outcome = setup.wait();
  EXPECT_EQ(outcome.exit_code, 0) << outcome.out << outcome.err;
  EXPECT_NE(outcome.out.find("verdict"), std::string::npos) << outcome.out;
  EXPECT_NE(outcome.out.find("celadond --config"), std::string::npos) << outcome.out;
  EXPECT_TRUE(fs::exists(machine_ + "/celadond.toml"));
  EXPECT_TRUE(fs::exists(machine_ + "/check/check.json"));
  EXPECT_TRUE(fs::exists(machine_ + "/first-scan/report.json"));
  expect_safe(station_);
}

TEST_F(SetupCommand, AMirroredPictureIsNamed) {
  keep_calibration();
  put("cylinder");
  Program setup({"celadon", "setup", "--camera", station_.camera, "--device", station_.url, "-o", machine_}, 0,
                Program::Input::answers);
  ASSERT_TRUE(setup.answer("Take everything off the table", ""));
  ASSERT_TRUE(setup.answer("Stand something bright", "")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Watch the table", "")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Did it turn", "cw")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Keep it?", "y")) << setup.wait().err;
  const auto outcome = setup.wait();
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_NE(outcome.err.find("mirrored"), std::string::npos) << outcome.err;
  expect_safe(station_);
}

// The signal is for setup alone; the command that it runs would wait for a board for ever.
TEST_F(SetupCommand, EndedItEndsTheCommandThatItRuns) {
  put("cylinder");
  Program setup({"celadon", "setup", "--camera", station_.camera, "--device", station_.url, "-o", machine_}, 0,
                Program::Input::answers);
  ASSERT_TRUE(setup.answer("Take everything off the table", ""));
  ASSERT_TRUE(setup.answer("Stand something bright", "")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Watch the table", "")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Did it turn", "ccw")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Which board?", "")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Its width", "")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("Its height", "")) << setup.wait().err;
  ASSERT_TRUE(setup.wait_for_output("> Hold the board")) << setup.wait().err;
  setup.signal(SIGTERM);
  EXPECT_EQ(setup.wait().exit_code, 130);
  EXPECT_FALSE(fs::exists(machine_ + "/scanner.toml"));
  expect_safe(station_);
}

TEST_F(SetupCommand, AnOpenInterlockIsSaidAndTriedAgain) {
  ask_simulator(station_.folder.path(), "fault interlock-open");
  Program setup({"celadon", "setup", "--camera", station_.camera, "--device", station_.url, "-o", machine_}, 0,
                Program::Input::answers);
  ASSERT_TRUE(setup.answer("Take everything off the table", "")) << setup.wait().err;
  ASSERT_TRUE(setup.answer("interlock is open", "n")) << setup.wait().err;
  EXPECT_EQ(setup.wait().exit_code, 1);
}

TEST_F(SetupCommand, WithoutAnswersItEndsSafely) {
  Program setup = start();
  ASSERT_TRUE(setup.answer("Its address?", station_.url));
  ASSERT_TRUE(setup.wait_for_output("Take everything off the table"));
  setup.hang_up();
  const auto outcome = setup.wait();
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_NE(outcome.err.find("answers have ended"), std::string::npos) << outcome.err;

  Program interrupted = start();
  ASSERT_TRUE(interrupted.wait_for_output("Its address?"));
  interrupted.signal(SIGINT);
  EXPECT_EQ(interrupted.wait().exit_code, 130);
  // Just before it begins to wait for an answer, too.
  for (int k = 0; k < 10; ++k) {
    Program early = start();
    ASSERT_TRUE(early.wait_for_output(k % 2 == 0 ? "1. Camera" : "2. Controller"));
    early.signal(k % 3 == 0 ? SIGTERM : SIGINT);
    ASSERT_EQ(early.wait().exit_code, 130);
  }
  const auto left = station_.state();
  EXPECT_TRUE(laser_off(left));
  EXPECT_EQ(left["motion"], "unhomed") << "nothing moved";
}

}  // namespace
}  // namespace celadon::testing
