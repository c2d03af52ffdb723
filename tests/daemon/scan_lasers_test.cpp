// Scans with two lasers on a machine in closed form: which lasers, a turn with each, never both at once.

#include "daemon/scan_lasers.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>

#include "acquisition/frame.h"
#include "daemon/profile_log.h"
#include "firmware_bridge/clock.h"
#include "tests/daemon/fake_machine.h"
#include "tests/daemon/scan_onlooker.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::FakeMachine;
using testing::TemporaryFolder;

TEST(LasersOf, AllThatAreCalibratedAndThereUnlessSomeAreNamed) {
  const Calibration both = FakeMachine().calibration(2), first = FakeMachine().calibration(1);
  const std::vector<int> one = {0}, two = {0, 1}, other = {3};
  EXPECT_EQ(lasers_of({}, both, two), two);
  EXPECT_EQ(lasers_of({}, both, one), one);
  EXPECT_EQ(lasers_of({}, first, two), one);
  ScanRequest turned_round;
  turned_round.lasers = {1, 0};
  EXPECT_EQ(lasers_of(turned_round, both, two), turned_round.lasers);

  ScanRequest second;
  second.lasers = {1};
  const auto uncalibrated = lasers_of(second, first, two);
  ASSERT_FALSE(uncalibrated);
  EXPECT_EQ(uncalibrated.error(),
            "Laser 1 was asked for, but the calibration of 2026-01-01T00:00:00Z holds lasers 0; calibrate it (celadon "
            "calibrate), or leave it out.");
  const auto absent = lasers_of(second, both, one);
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error(), "Laser 1 was asked for, but the machine has lasers 0; leave it out.");
  EXPECT_FALSE(lasers_of({}, both, other));
}

ScanTask task_in(const TemporaryFolder& folder, ScanMode mode, const std::string& name = "scan") {
  ScanTask task;
  task.request.profiles = 24;
  task.request.mode = mode;
  task.request.formats = {"surface.json"};
  task.date = "2026-01-02T03:04:05Z";
  task.log_file = folder / (name + ".log");
  task.results_folder = folder / (name + "-results");
  return task;
}

tl::expected<ScanOutcome, ScanStop> scan_with(FakeMachine& machine, const Calibration& calibration,
                                              const ScanTask& task, ScanObserver& observer) {
  auto connection = machine.connect(calibration);
  EXPECT_TRUE(connection) << connection.error().message;
  return run_scan({connection->device.get(), *connection->camera, *connection->clock, calibration, nullptr, {}}, task,
                  observer);
}

std::vector<Profile> profiles_of(const std::filesystem::path& file, bool overlap = false) {
  std::vector<Profile> profiles;
  auto log = ProfileLogReader::open(file);
  EXPECT_TRUE(log) << log.error().message;
  while (const auto entry = (*log)->next_entry()) {
    const auto* logged = std::get_if<LoggedProfile>(&*entry);
    if (logged != nullptr && logged->overlap == overlap) profiles.push_back(*logged->profile);
  }
  EXPECT_EQ((*log)->error(), "");
  return profiles;
}

/// Masks of lasers as the controller set them, in order, without repeats.
std::vector<std::uint16_t> masks_of(FakeMachine& machine) {
  std::vector<std::uint16_t> masks;
  machine.with_plant([&](test::TestPlant& plant) {
    for (const auto& [time_us, mask] : plant.laser_log) {
      if (masks.empty() || masks.back() != mask) masks.push_back(mask);
    }
  });
  return masks;
}

TEST(ScanLasers, EachHasATurnOfItsOwnAndNeverBothShine) {
  for (const ScanMode mode : {ScanMode::sweep, ScanMode::step}) {
    FakeMachine machine;
    const TemporaryFolder folder;
    const ScanTask task = task_in(folder, mode);
    ScanOnlooker watcher;
    const auto outcome = scan_with(machine, machine.calibration(2), task, watcher);
    ASSERT_TRUE(outcome) << outcome.error().reason;
    EXPECT_EQ(machine.lasers(), 0);
    for (const std::uint16_t mask : masks_of(machine)) EXPECT_LT(mask, 3) << "both at once";

    auto log = ProfileLogReader::open(task.log_file);
    ASSERT_TRUE(log);
    EXPECT_EQ((*log)->header().lasers, (std::vector<int>{0, 1}));
    const auto profiles = profiles_of(task.log_file);
    const auto of = [&](int laser) {
      return std::count_if(profiles.begin(), profiles.end(), [&](const Profile& p) { return p.laser == laser; });
    };
    EXPECT_GE(of(0), 24);
    EXPECT_GE(of(1), 24);
    std::uint32_t index = 0;
    double last_rad = -1;
    bool second = false;
    for (const Profile& p : profiles) {
      EXPECT_TRUE(p.laser == 1 || !second) << "the turns follow one another";
      second = p.laser == 1;
      EXPECT_TRUE(p.index >= index) << p.index;
      index = p.index;
      // On and on the same way: the second turn begins where the first one ended.
      EXPECT_GT(p.table_angle_rad, last_rad);
      last_rad = p.table_angle_rad;
      // Both measure the same object, in its own frame.
      for (std::size_t i = 0; i < p.size(); ++i) {
        const double truth_mm = FakeMachine::vase(p.theta_rad[i], p.z_mm[i]);
        if (truth_mm > 0) {
          ASSERT_NEAR(p.r_mm[i], truth_mm, 0.3) << p.index;
        }
      }
    }
    EXPECT_EQ(watcher.progress.fraction, 1);
    EXPECT_EQ(watcher.progress.frames_expected, 2 * 28);
    EXPECT_TRUE(std::is_sorted(watcher.fractions.begin(), watcher.fractions.end()));

    const auto report = nlohmann::json::parse(testing::read_file(task.results_folder / "report.json"));
    ASSERT_EQ(report["lasers"].size(), 2u);
    EXPECT_EQ(report["lasers"][1]["laser"], 1);
    EXPECT_EQ(report["lasers"][0]["samples"].get<int>() + report["lasers"][1]["samples"].get<int>(),
              report["points"].get<int>());
    EXPECT_EQ(report["scan"]["profiles"].get<std::size_t>(), profiles.size());
    for (const auto& share : report["lasers"]) EXPECT_GT(share["closure_mm"]["samples"], 100);
  }
}

TEST(ScanLasers, OnlyTheOneNamedShines) {
  FakeMachine machine;
  const TemporaryFolder folder;
  ScanTask task = task_in(folder, ScanMode::sweep);
  task.request.lasers = {1};
  ScanOnlooker watcher;
  const auto outcome = scan_with(machine, machine.calibration(2), task, watcher);
  ASSERT_TRUE(outcome) << outcome.error().reason;
  for (const std::uint16_t mask : masks_of(machine)) EXPECT_TRUE(mask == 0 || mask == 2) << mask;
  for (const Profile& p : profiles_of(task.log_file)) ASSERT_EQ(p.laser, 1);
}

TEST(ScanLasers, OneThatIsNotThereIsRefusedBeforeAnythingMoves) {
  FakeMachine machine;
  const TemporaryFolder folder;
  ScanTask task = task_in(folder, ScanMode::sweep);
  for (const std::vector<int>& lasers : {std::vector<int>{1}, {0, 3}}) {
    task.request.lasers = lasers;
    ScanOnlooker watcher;
    const auto outcome = scan_with(machine, machine.calibration(1), task, watcher);
    ASSERT_FALSE(outcome);
    EXPECT_NE(outcome.error().reason.find("Laser " + std::to_string(lasers.back()) + " was asked for"),
              std::string::npos)
        << outcome.error().reason;
    EXPECT_FALSE(std::filesystem::exists(task.log_file));
    machine.with_plant([](test::TestPlant& plant) {
      EXPECT_EQ(plant.homes + plant.moves, 0);
      EXPECT_EQ(plant.lasers, 0);
    });
    for (const std::uint16_t mask : masks_of(machine)) EXPECT_EQ(mask, 0);
  }
}

// A table whose travel ends before a second turn goes back between the two, to where the first began.
TEST(ScanLasers, ATableWithoutEndlessTurnsGoesBack) {
  for (const ScanMode mode : {ScanMode::sweep, ScanMode::step}) {
    FakeMachine machine(0, mode == ScanMode::sweep ? 900 : 700);  // one turn ends at 809 and 420 degrees
    const TemporaryFolder folder;
    const ScanTask task = task_in(folder, mode);
    ScanOnlooker watcher;
    const auto outcome = scan_with(machine, machine.calibration(2), task, watcher);
    ASSERT_TRUE(outcome) << outcome.error().reason;
    const auto profiles = profiles_of(task.log_file);
    const auto second = std::find_if(profiles.begin(), profiles.end(), [](const Profile& p) { return p.laser == 1; });
    ASSERT_NE(second, profiles.end());
    EXPECT_NEAR(second->table_angle_rad, profiles.front().table_angle_rad, 0.3);
    EXPECT_GT(profiles.back().table_angle_rad, second->table_angle_rad + 5);
  }
}

TEST(ScanLasers, ALaserThatStaysOnAfterItsTurnIsToldAndTheOtherIsNotSwitchedOn) {
  FakeMachine machine;
  const TemporaryFolder folder;
  ScanOnlooker watcher;
  watcher.at_progress = [&](const ScanProgress& now) { machine.laser_hidden = now.fraction > 0.2; };
  const ScanTask task = task_in(folder, ScanMode::step);
  const auto outcome = scan_with(machine, machine.calibration(2), task, watcher);
  ASSERT_FALSE(outcome);
  EXPECT_NE(outcome.error().reason.find("Laser 0 did not go out after its turn"), std::string::npos)
      << outcome.error().reason;
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(machine.speed(), 0);
  for (const Profile& p : profiles_of(task.log_file)) EXPECT_EQ(p.laser, 0);
}

TEST(ScanLasers, CancelledAtAnyInstantItIsSafeAndKeepsItsLog) {
  const Calibration calibration = FakeMachine().calibration(2);
  bool whole = false;
  int cut_short = 0;
  for (int instant = 5; !whole; instant += 13) {
    FakeMachine machine;
    const TemporaryFolder folder;
    const ScanTask task = task_in(folder, instant % 2 == 0 ? ScanMode::sweep : ScanMode::step);
    ScanOnlooker watcher;
    watcher.cancel_at = instant;
    const auto outcome = scan_with(machine, calibration, task, watcher);
    ASSERT_EQ(machine.lasers(), 0) << instant;
    ASSERT_EQ(machine.speed(), 0) << instant;
    for (const std::uint16_t mask : masks_of(machine)) ASSERT_LT(mask, 3) << instant;
    whole = outcome.has_value();
    if (whole) continue;
    ++cut_short;
    ASSERT_EQ(outcome.error().state, ScanState::cancelled) << outcome.error().reason;
    if (std::filesystem::exists(task.log_file)) profiles_of(task.log_file);
  }
  EXPECT_GT(cut_short, 10);
}

/// A cylinder in the middle.
double round_part(double, double z_mm) {
  return z_mm < 5 || z_mm > 100 ? 0 : 30;
}

TEST(ScanLasers, APlaneThatMovedIsNamed) {
  for (const double moved_mm : {0., 0.1}) {
    FakeMachine machine;
    machine.shape = round_part;
    const TemporaryFolder folder;
    ScanTask task = task_in(folder, ScanMode::sweep);
    task.request.profiles = 120;
    Calibration calibration = machine.calibration(2);
    calibration.lasers[1].distance_mm += moved_mm;
    ScanOnlooker watcher;
    const auto outcome = scan_with(machine, calibration, task, watcher);
    ASSERT_TRUE(outcome) << outcome.error().reason;
    const auto report = nlohmann::json::parse(testing::read_file(task.results_folder / "report.json"));
    ASSERT_TRUE(report.contains("agreement_mm"));
    // The ray meets the plane at about 30 degrees less the view's own slant: a radius is wrong by about twice the
    // shift.
    const double bias = std::abs(report["agreement_mm"]["bias"].get<double>());
    if (moved_mm == 0) {
      EXPECT_LT(bias, 0.01);
    } else {
      EXPECT_NEAR(bias, 0.2, 0.05);
    }
    const bool named = std::any_of(outcome->checks.begin(), outcome->checks.end(), [](const SelfCheck& check) {
      return check.name == "laser_agreement" && check.verdict == CheckVerdict::failed &&
             check.cause.find("the plane of laser 0 or 1") != std::string::npos;
    });
    EXPECT_EQ(named, moved_mm != 0) << report["agreement_mm"] << report["checks"];
  }
}

TEST(ScanLasers, ARecordingGivesTheSameSamplesOfEachLaser) {
  FakeMachine machine;
  const TemporaryFolder folder;
  ScanTask task = task_in(folder, ScanMode::sweep);
  task.recording_folder = folder / "frames";
  const Calibration calibration = machine.calibration(2);
  ScanOnlooker watcher;
  const auto outcome = scan_with(machine, calibration, task, watcher);
  ASSERT_TRUE(outcome) << outcome.error().reason;

  auto recording = open_frame_source("replay:" + (folder / "frames").string());
  ASSERT_TRUE(recording) << recording.error().message;
  EXPECT_EQ((*recording)->recorded()->lasers, (std::vector<int>{0, 1}));
  MonotonicClock clock;
  const ScanEquipment equipment{nullptr, **recording, clock, calibration, nullptr, {}};
  const ScanTask again = task_in(folder, ScanMode::sweep, "again");
  const auto replayed = run_scan(equipment, again, watcher);
  ASSERT_TRUE(replayed) << replayed.error().reason;
  const auto live = profiles_of(task.log_file), same = profiles_of(again.log_file);
  ASSERT_EQ(live.size(), same.size());
  for (std::size_t k = 0; k < live.size(); ++k) {
    EXPECT_EQ(live[k].laser, same[k].laser);
    EXPECT_EQ(live[k].r_mm, same[k].r_mm);
    EXPECT_EQ(live[k].theta_rad, same[k].theta_rad);
    EXPECT_EQ(live[k].z_mm, same[k].z_mm);
  }
  EXPECT_EQ(testing::read_file(task.results_folder / "surface.json"),
            testing::read_file(again.results_folder / "surface.json"));

  ScanTask second = task_in(folder, ScanMode::sweep, "second");
  second.request.lasers = {1};
  ASSERT_TRUE(run_scan(equipment, second, watcher));
  for (const Profile& p : profiles_of(second.log_file)) ASSERT_EQ(p.laser, 1);
}

}  // namespace
}  // namespace celadon
