// celadon device status, home and move with a virtual scanner that has all axes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <csignal>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/integration/process.h"

namespace celadon::testing {
namespace {

using ::testing::AllOf;
using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using ::testing::Not;

struct AxesMachine {
  explicit AxesMachine(const std::vector<std::string>& options)
      : sim([&] {
          std::vector<std::string> command = {
              "celadon-sim", "--socket-dir", folder.path().string(), "--width", "64", "--height", "64"};
          command.insert(command.end(), options.begin(), options.end());
          return command;
        }()) {
    EXPECT_TRUE(sim.wait_for_output("\n"));
    url = nlohmann::json::parse(sim.out().substr(0, sim.out().find('\n')))["modbus_url"];
  }
  ~AxesMachine() { sim.signal(SIGTERM); }
  Outcome device(std::vector<std::string> words) {
    words.insert(words.begin(), {"celadon", "device"});
    words.insert(words.begin() + 3, url);
    return run(words);
  }
  nlohmann::json state() {
    return nlohmann::json::parse(run({"celadon-sim", "state", "--socket-dir", folder.path().string()}).out);
  }
  TemporaryFolder folder;
  Program sim;
  std::string url;
};

TEST(DeviceAxes, AreShownHomedAndMoved) {
  AxesMachine m({"--elevation", "--lift", "--seed", "3"});
  const auto fresh = m.device({"status"});
  EXPECT_EQ(fresh.exit_code, 0) << fresh.err;
  EXPECT_THAT(fresh.out, HasSubstr("protocol 1.3, simulated"));
  EXPECT_THAT(fresh.out, ContainsRegex("table +unhomed +no .* endless +180 deg/s, 1000 deg/s2"));
  EXPECT_THAT(fresh.out, ContainsRegex("elevation +unhomed +no .* -10.000 deg to 70.000 deg +30 deg/s"));
  EXPECT_THAT(fresh.out, ContainsRegex("lift +unhomed +no .* -150.000 mm to 150.000 mm +40 mm/s"));
  const auto refused = m.device({"move", "--lift", "5"});
  EXPECT_EQ(refused.exit_code, 3);
  EXPECT_THAT(refused.err,
              AllOf(HasSubstr("move the lift to 5.000 mm"), HasSubstr("not homed"), HasSubstr("home it first")));
  const auto homed = m.device({"home", "--axis", "elevation"});
  EXPECT_EQ(homed.exit_code, 0) << homed.err;
  EXPECT_THAT(homed.out, ContainsRegex("elevation +standstill +0.000 deg"));
  EXPECT_THAT(homed.out, ContainsRegex("lift +unhomed"));
  const auto moved = m.device({"move", "--elevation", "12.5"});
  EXPECT_EQ(moved.exit_code, 0) << moved.err;
  EXPECT_NEAR(m.state()["elevation"]["angle_rad"].get<double>(), 12.5 * 0.0174532925, 3e-4) << "up to 0.1 % of scale";
  const auto beyond = m.device({"move", "--elevation", "71"});
  EXPECT_EQ(beyond.exit_code, 3);
  EXPECT_THAT(beyond.err, HasSubstr("stay between -10.000 deg and 70.000 deg"));
  EXPECT_EQ(m.device({"move"}).exit_code, 2);
}

TEST(DeviceAxes, AMachineWithATableAloneShowsItAlone) {
  AxesMachine m({});
  const auto status = m.device({"status"});
  EXPECT_EQ(status.exit_code, 0) << status.err;
  EXPECT_THAT(status.out, AllOf(HasSubstr("table"), Not(HasSubstr("elevation")), Not(HasSubstr("lift"))));
  EXPECT_EQ(m.state()["lift"], nullptr);
  const auto moved = m.device({"move", "--lift", "3"});
  EXPECT_EQ(moved.exit_code, 3);
  EXPECT_THAT(moved.err, HasSubstr("no axis of the kind lift"));
}

TEST(DeviceAxes, PicturesAndTruthKnowTheReadings) {
  const auto bare = run({"celadon-sim", "frame", "--elevation-angle", "10", "-o", "none.png"});
  EXPECT_EQ(bare.exit_code, 2);
  EXPECT_THAT(bare.err, HasSubstr("add --elevation"));
  const auto far = run({"celadon-sim", "truth", "--lift", "--corners", "--lift-height", "151"});
  EXPECT_EQ(far.exit_code, 2);
  EXPECT_THAT(far.err, HasSubstr("-150 to 150"));
  const auto truth = run({"celadon-sim", "truth", "--elevation", "--lift", "--calibration", "-"});
  EXPECT_EQ(truth.exit_code, 0);
  EXPECT_THAT(truth.out, AllOf(HasSubstr("[elevation]"), HasSubstr("[lift]")));
}

}  // namespace
}  // namespace celadon::testing
