// What a scan finds out about itself on the virtual scanner: a sample of the table of daemon/README.md. The whole, and
// scans without a fault: tools/campaign self_checks.

#include <gtest/gtest.h>

#include <csignal>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/integration/process.h"
#include "tests/integration/self_check_cells.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

constexpr int kProfiles = 400;
constexpr int kFewProfiles = 150;  // tags are in every one of them

struct Expected {
  const char *scene, *order;
  std::vector<const char*> failed;   ///< these do
  std::vector<const char*> unknown;  ///< these are not verifiable
  const char* named;                 ///< word of the cause, as the terminal shows it; empty: nothing fails
};

class SelfCheckCells : public ::testing::TestWithParam<Expected> {};

TEST_P(SelfCheckCells, IsAsTheTableSays) {
  const Expected& expected = GetParam();
  const CheckedCell cell = try_self_checks(expected.scene, expected.order, 1, kProfiles);
  ASSERT_FALSE(cell.checks.empty()) << cell.err;
  for (const char* name : expected.failed)
    EXPECT_EQ(cell.verdict(name), "failed") << name << "\n" << cell.checks.dump(1);
  for (const char* name : expected.unknown)
    EXPECT_EQ(cell.verdict(name), "not verifiable") << name << "\n" << cell.checks.dump(1);
  EXPECT_EQ(cell.exit_code, expected.failed.empty() ? 0 : 1) << cell.err;
  if (expected.failed.empty()) {
    EXPECT_EQ(cell.names_of("failed"), "");
  } else {
    EXPECT_NE(cell.out.find("CHECK FAILED"), std::string::npos) << cell.out;
    EXPECT_NE(cell.out.find(expected.named), std::string::npos) << cell.out;
    EXPECT_NE(cell.err.find("the scan is kept"), std::string::npos) << cell.err;
  }
}

INSTANTIATE_TEST_SUITE_P(
    Sample, SelfCheckCells,
    ::testing::Values(
        Expected{"cylinder", "", {}, {"turn"}, ""}, Expected{"cylinder", "steps-wrong 1.01", {}, {"turn"}, ""},
        Expected{"cylinder", "object-wobble 0.5", {"steadiness"}, {"turn"}, "rocks"},
        Expected{"cylinder", "camera-nudge 0.2 angle 180", {"closure"}, {"turn"}, "camera, laser or object"},
        Expected{"cylinder", "lights-on 6 angle 180", {"room_light"}, {"turn"}, "brighter"},
        Expected{"cylinder-off", "", {}, {}, ""}, Expected{"vase-squeezed", "", {}, {"harmonic_1"}, ""},
        Expected{"vase-squeezed", "steps-wrong 1.01", {"turn"}, {"harmonic_1"}, "steps per turn are wrong"},
        Expected{"vase-squeezed", "object-slip 2 angle 180", {"turn"}, {"harmonic_1"}, "slipped"},
        Expected{"humidifier", "", {}, {"harmonic_1"}, ""},
        Expected{"humidifier", "steps-wrong 1.01", {"turn"}, {"harmonic_1"}, "steps per turn are wrong"},
        Expected{"humidifier", "backlash 0.5", {}, {"harmonic_1"}, ""}));

struct Watched {
  const char *scene, *order;
  CheckedMachine machine;
  const char* failed;  ///< empty: nothing does
  const char* named;   ///< word of the cause
};

class DatumCells : public ::testing::TestWithParam<Watched> {};

// What a centred round object cannot show, the datum does.
TEST_P(DatumCells, TheDatumNamesTheFault) {
  const Watched& expected = GetParam();
  const CheckedCell cell = try_self_checks(expected.scene, expected.order, 1, kFewProfiles, expected.machine);
  ASSERT_FALSE(cell.checks.empty()) << cell.err;
  if (std::string(expected.failed).empty()) {
    EXPECT_EQ(cell.names_of("failed"), "") << cell.checks.dump(1);
    for (const char* name : {"datum_turn", "datum_angle", "datum_time", "datum_camera"})
      EXPECT_EQ(cell.verdict(name), "passed") << name << "\n" << cell.checks.dump(1);
  } else {
    EXPECT_EQ(cell.verdict(expected.failed), "failed") << cell.checks.dump(1);
    EXPECT_NE(cell.out.find(expected.named), std::string::npos) << cell.out;
  }
}

INSTANTIATE_TEST_SUITE_P(
    Sample, DatumCells,
    ::testing::Values(Watched{"cylinder", "", {1, true}, "", ""}, Watched{"humidifier", "", {1, true}, "", ""},
                      Watched{"cylinder", "steps-wrong 1.01", {1, true}, "datum_turn", "steps per turn are wrong"},
                      Watched{"cylinder", "motor-slip -2 angle 180", {1, true}, "datum_angle", "slipped"},
                      Watched{"cylinder", "camera-nudge 0.2", {1, true}, "datum_camera", "the camera stands otherwise"},
                      Watched{"cylinder", "camera-nudge 0.2 angle 180", {1, true}, "datum_camera", "during the scan"},
                      Watched{"cylinder", "calibration frames-late", {1, true}, "datum_time", "do not belong together"},
                      // Fiducials that pass in room light are taken for a line here and there: they hide no platter.
                      Watched{"cylinder", "calibration laser-moved", {1, true}, "datum_laser 0", "over the platter"}));

// The record of the scan says it to the API's clients, also after a restart, and the daemon's log does.
TEST(SelfCheckRecord, IsInTheApiTheStoreAndTheLog) {
  Station station("humidifier");
  station.start_daemon();
  ask_simulator(station.folder.path(), "fault steps-wrong 1.01");
  const auto scan = run({"celadon", "scan", "--server", station.server(), "--profiles", std::to_string(kProfiles),
                         "--formats", "surface.json", "--json", "-o", station.folder / "out"});
  EXPECT_EQ(scan.exit_code, 1) << scan.err;
  const auto find_turn = [](const nlohmann::json& checks) {
    for (const auto& check : checks)
      if (check.value("name", "") == "turn") return check.value("verdict", "");
    return std::string("none");
  };
  const auto record = nlohmann::json::parse(read_file(station.folder / "store" / "scans" / "000001" / "scan.json"));
  EXPECT_EQ(find_turn(record["checks"]), "failed") << record.dump(1);
  EXPECT_NE(scan.out.find("\"checks\":["), std::string::npos);
  station.daemon->signal(SIGTERM);
  const auto ended = station.daemon->wait();
  EXPECT_NE(ended.err.find("check failed: turn"), std::string::npos) << ended.err;
  // A record with checks is read again.
  station.start_daemon();
  const auto status = run({"celadon", "status", "--server", station.server()});
  EXPECT_NE(status.out.find("scan 1  done"), std::string::npos) << status.out;
}

}  // namespace
}  // namespace celadon::testing
