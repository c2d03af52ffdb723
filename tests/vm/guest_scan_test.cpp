// One scan as a user makes it, within a machine of its own: virtual scanner, daemon and command line are processes of
// the guest, the controller speaks Modbus RTU through the guest's own terminal driver.
#include <gtest/gtest.h>

#include <cmath>
#include <csignal>

#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// A small picture and few frames a second: every frame is drawn under emulation.
const std::vector<std::string> kSmallMachine = {"--width", "400", "--height", "320", "--fps", "12"};

TEST(GuestScan, APressOfTheButtonLeavesASolidCloseToTheTruth) {
  Station station("cylinder", kSmallMachine, Station::Link::modbus_rtu);
  ASSERT_EQ(station.url.rfind("modbus-rtu:", 0), 0u) << station.url;
  const auto config = station.folder.write("celadond.toml", "[scan]\nprofiles = 36\n");
  station.start_daemon({"--config", config});
  Program watch({"celadon", "watch", "--server", station.server(), "--json", "-o", station.folder / "out"});
  ASSERT_EQ(run({"celadon-sim", "press", "--socket-dir", station.folder.path()}).exit_code, 0);
  const auto outcome = watch.wait();
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err << outcome.out;
  EXPECT_NE(outcome.out.find("\"requested_by\":\"button\""), std::string::npos);

  const json report = json::parse(read_file(station.folder / "out" / "report.json"));
  EXPECT_EQ(report["simulated"], true);
  EXPECT_EQ(report["model"], "cylinder") << report["decided_by"];
  EXPECT_LT(report["truth_mm"]["max"], 0.05);
  EXPECT_EQ(report["solid"]["valid"], true);
  EXPECT_GT(report["solid"]["volume_mm3"], 0.0);
  const std::string step = read_file(station.folder / "out" / "object.step");
  EXPECT_EQ(step.rfind("ISO-10303-21;", 0), 0u);
  EXPECT_NE(step.find("END-ISO-10303-21;"), std::string::npos);
  EXPECT_NE(step.substr(0, 2000).find("simulated"), std::string::npos);
  expect_safe(station);
}

// No software of ours acts: the guest's kernel closes the terminal, and the controller's lease runs out.
TEST(GuestScan, AKilledDaemonLeavesTheLaserOffWithinTheLease) {
  Station station("cylinder", kSmallMachine, Station::Link::modbus_rtu);
  station.start_daemon();
  Program scan({"celadon", "scan", "--server", station.server(), "--json"});
  ASSERT_TRUE(scan.wait_for_output("\"state\":\"scanning\"")) << scan.wait().err;
  station.daemon->signal(SIGKILL);
  station.daemon->wait();
  expect_laser_off_within_lease(station);
  EXPECT_NE(scan.wait().exit_code, 0);
}

}  // namespace
}  // namespace celadon::testing
