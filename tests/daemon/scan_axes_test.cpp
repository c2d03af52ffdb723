// Scans with the head's elevation axis and the table's lift, on a machine in closed form.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "acquisition/frame.h"
#include "daemon/profile_log.h"
#include "daemon/scan_job.h"
#include "firmware_bridge/clock.h"
#include "tests/daemon/fake_machine.h"
#include "tests/daemon/scan_onlooker.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::FakeMachine;
using testing::TemporaryFolder;

constexpr double kDegree = std::numbers::pi / 180;

ScanTask task_at(const TemporaryFolder& folder, std::vector<double> elevations_deg, std::vector<double> lifts_mm,
                 const std::string& name = "scan") {
  ScanTask task;
  task.request.profiles = 24;
  task.request.formats = {"surface.json"};
  task.request.elevations_deg = std::move(elevations_deg);
  task.request.lifts_mm = std::move(lifts_mm);
  task.date = "2026-01-02T03:04:05Z";
  task.log_file = folder / (name + ".log");
  task.results_folder = folder / (name + "-results");
  return task;
}

tl::expected<ScanOutcome, ScanStop> scan_of(FakeMachine& machine, const Calibration& calibration, const ScanTask& task,
                                            ScanObserver& observer) {
  auto connection = machine.connect(calibration);
  EXPECT_TRUE(connection) << connection.error().message;
  return run_scan({connection->device.get(), *connection->camera, *connection->clock, calibration, nullptr, {}}, task,
                  observer);
}

struct StoppedProfile {
  AxisStop stop;
  Profile profile;
};

std::vector<StoppedProfile> stopped_profiles(const std::filesystem::path& file) {
  std::vector<StoppedProfile> out;
  auto log = ProfileLogReader::open(file);
  EXPECT_TRUE(log) << log.error().message;
  AxisStop stop;
  while (const auto entry = (*log)->next_entry()) {
    if (const auto* at = std::get_if<LogStop>(&*entry)) stop = at->stop;
    const auto* logged = std::get_if<LoggedProfile>(&*entry);
    if (logged != nullptr && !logged->overlap) out.push_back({stop, *logged->profile});
  }
  EXPECT_EQ((*log)->error(), "");
  return out;
}

/// No laser shone while head or lift moved.
void expect_dark_moves(FakeMachine& machine) {
  EXPECT_EQ(machine.lit_while_axes_moved(), 0);
}

TEST(ScanAxes, SamplesOfEveryStopLieOnTheObject) {
  FakeMachine machine(0, 0, true);
  const TemporaryFolder folder;
  const ScanTask task = task_at(folder, {0, 25}, {0, 30});
  ScanOnlooker onlooker;
  const auto outcome = scan_of(machine, machine.calibration(2), task, onlooker);
  ASSERT_TRUE(outcome) << outcome.error().reason;
  EXPECT_EQ(machine.lasers(), 0);
  expect_dark_moves(machine);

  const auto profiles = stopped_profiles(task.log_file);
  std::vector<std::pair<AxisStop, int>> turns;
  std::uint32_t next = 0;
  std::size_t off = 0, wall = 0;
  for (const auto& [stop, profile] : profiles) {
    if (turns.empty() || turns.back() != std::pair(stop, int{profile.laser})) turns.emplace_back(stop, profile.laser);
    EXPECT_GE(profile.index, next);
    next = profile.index + 1;
    EXPECT_EQ(profile.lift_mm, 0) << "taken off already";
    for (std::size_t i = 0; i < profile.size(); ++i) {
      const double truth_mm = FakeMachine::vase(profile.theta_rad[i], profile.z_mm[i]);
      if (truth_mm <= 0 || profile.r_mm[i] < 20) continue;  // the top, and its edge
      ++wall;
      off += std::abs(profile.r_mm[i] - truth_mm) > 0.3 && profile.z_mm[i] < 99 ? 1 : 0;
    }
  }
  EXPECT_GT(wall, 5000u);
  EXPECT_LT(off, wall / 500);
  // Both lasers at each stop, the lift moving least.
  ASSERT_EQ(turns.size(), 8u);
  for (std::size_t k = 0; k < 8; ++k) {
    EXPECT_NEAR(turns[k].first.elevation_rad, k / 2 % 2 == 0 ? 0 : 25 * kDegree, 1e-4) << k;
    EXPECT_NEAR(turns[k].first.lift_mm, k < 4 ? 0 : 30, 2e-3) << k;
    EXPECT_EQ(turns[k].second, static_cast<int>(k % 2));
  }
  EXPECT_EQ(onlooker.progress.fraction, 1);
  EXPECT_EQ(onlooker.progress.frames_expected, 8 * 28);
  EXPECT_TRUE(std::is_sorted(onlooker.fractions.begin(), onlooker.fractions.end()));

  const auto report = nlohmann::json::parse(testing::read_file(task.results_folder / "report.json"));
  ASSERT_EQ(report["lasers"].size(), 8u);
  EXPECT_NEAR(report["lasers"][7]["elevation_deg"], 25, 0.01);
  EXPECT_NEAR(report["lasers"][7]["lift_mm"], 30, 2e-3);
  for (const auto& share : report["lasers"]) EXPECT_GT(share["samples"], 100);
  for (const SelfCheck& check : outcome->checks) {
    EXPECT_NE(check.verdict, CheckVerdict::failed) << sentence_of(check);
  }
}

/// A bun whose nearly flat top is in reach of a raised head only; its middle is not where the axes cross.
double bun(double, double z_mm) {
  const double square = 1 - std::pow((z_mm - 53) / 42, 8);
  return square > 0 ? 35 * std::sqrt(square) : 0;
}

TEST(ScanAxes, ARaisedHeadSeesMoreOfTheTopAboutTheCrossing) {
  std::vector<double> coverage;
  for (const std::vector<double>& elevations : {std::vector<double>{0}, {0, 55}}) {
    FakeMachine machine(0, 0, true);
    machine.shape = bun;
    const TemporaryFolder folder;
    ScanTask task = task_at(folder, elevations, {});
    task.request.shape = "sphere";
    task.request.profiles = 60;
    ScanOnlooker onlooker;
    const Calibration calibration = machine.calibration(2);
    const auto outcome = scan_of(machine, calibration, task, onlooker);
    ASSERT_TRUE(outcome) << outcome.error().reason;
    const auto report = nlohmann::json::parse(testing::read_file(task.results_folder / "report.json"));
    const auto surface = nlohmann::json::parse(testing::read_file(task.results_folder / "surface.json"));
    EXPECT_EQ(surface["base"]["kind"], "sphere");
    EXPECT_NEAR(surface["base"]["frame"]["origin"][2], crossing_of(*calibration.elevation).z_mm, 1e-9);
    coverage.push_back(report["coverage"]);
  }
  EXPECT_GT(coverage[1], coverage[0] + 0.01);
}

TEST(ScanAxes, ACalibrationThatTurnsTheHeadWronglyShowsInTheErrors) {
  // What the tests above rest on: 5 % of the elevation puts the samples of the raised head elsewhere.
  FakeMachine machine(0, 0, true);
  const TemporaryFolder folder;
  const ScanTask task = task_at(folder, {25}, {});
  ScanOnlooker onlooker;
  Calibration wrong = machine.calibration(1);
  wrong.elevation->scale.value *= 1.05;
  const auto outcome = scan_of(machine, wrong, task, onlooker);
  double worst = 0;
  for (const auto& [stop, profile] : stopped_profiles(task.log_file)) {
    for (std::size_t i = 0; i < profile.size(); ++i) {
      if (profile.z_mm[i] > 20 && profile.z_mm[i] < 80)
        worst = std::max(worst, std::abs(profile.r_mm[i] - FakeMachine::vase(profile.theta_rad[i], profile.z_mm[i])));
    }
  }
  EXPECT_GT(worst, 0.6);
}

/// A cylinder in the middle.
double round_part(double, double z_mm) {
  return z_mm < 5 || z_mm > 100 ? 0 : 30;
}

TEST(ScanAxes, AnAxisThatLeftItsCalibrationIsNamed) {
  for (const double by : {1.0, 1.02}) {
    FakeMachine machine(0, 0, true);
    machine.shape = round_part;
    const TemporaryFolder folder;
    ScanTask task = task_at(folder, {0, 20}, {});
    task.request.profiles = 120;
    ScanOnlooker onlooker;
    Calibration calibration = machine.calibration(1);
    calibration.elevation->scale.value *= by;
    const auto outcome = scan_of(machine, calibration, task, onlooker);
    ASSERT_TRUE(outcome) << outcome.error().reason;
    int checks = 0, failed = 0;
    for (const SelfCheck& check : outcome->checks) {
      if (!check.name.starts_with("stop_")) continue;
      ++checks;
      failed += check.verdict == CheckVerdict::failed ? 1 : 0;
      EXPECT_NE(check.verdict, CheckVerdict::not_verifiable) << check.note;
      if (check.verdict == CheckVerdict::failed) {
        EXPECT_NE(check.cause.find("an axis is no longer where it was calibrated"), std::string::npos) << check.cause;
      }
    }
    EXPECT_EQ(checks, 2);
    EXPECT_EQ(failed > 0, by != 1) << to_json(outcome->checks);
  }
}

TEST(ScanAxes, WithoutStopsTheAxesAreBroughtTo0) {
  FakeMachine machine(0, 0, true);
  const TemporaryFolder folder;
  ScanOnlooker onlooker;
  const ScanTask away = task_at(folder, {20}, {15}, "away"), task = task_at(folder, {}, {});
  const Calibration calibration = machine.calibration(1);
  ASSERT_TRUE(scan_of(machine, calibration, away, onlooker));
  const auto outcome = scan_of(machine, calibration, task, onlooker);
  ASSERT_TRUE(outcome) << outcome.error().reason;
  for (const auto& [stop, profile] : stopped_profiles(task.log_file)) {
    ASSERT_NEAR(stop.elevation_rad, 0, 1e-4);
    ASSERT_NEAR(stop.lift_mm, 0, 2e-3);
  }
}

TEST(ScanAxes, AStopOutOfReachIsRefusedBeforeAnythingMoves) {
  FakeMachine machine(0, 0, true);
  const TemporaryFolder folder;
  ScanOnlooker onlooker;
  const ScanTask task = task_at(folder, {0, 161}, {});
  const auto outcome = scan_of(machine, machine.calibration(1), task, onlooker);
  ASSERT_FALSE(outcome);
  EXPECT_EQ(outcome.error().reason,
            "Elevation 161 degrees was asked for, but the axis goes from -20 to 160 degrees; choose within.");
  EXPECT_FALSE(std::filesystem::exists(task.log_file));
  machine.with_plant([](test::TestPlant& plant) { EXPECT_EQ(plant.homes + plant.moves, 0); });
}

TEST(ScanAxes, StoppedInALaterTurnItIsSafeAndKeepsWhatItHas) {
  const std::vector<std::function<void(FakeMachine&)>> ends = {
      [](FakeMachine& machine) { machine.press_button(); },
      [](FakeMachine& machine) { machine.with_plant([](test::TestPlant& plant) { plant.interlock_closed = false; }); }};
  for (std::size_t k = 0; k < ends.size(); ++k) {
    FakeMachine machine(0, 0, true);
    const TemporaryFolder folder;
    const ScanTask task = task_at(folder, {0, 25}, {});
    ScanOnlooker onlooker;
    bool done = false;
    onlooker.at_progress = [&](const ScanProgress& now) {
      if (now.fraction > 0.6 && !done) {
        done = true;
        ends[k](machine);
      }
    };
    const auto outcome = scan_of(machine, machine.calibration(1), task, onlooker);
    ASSERT_FALSE(outcome);
    EXPECT_EQ(outcome.error().state, k == 0 ? ScanState::cancelled : ScanState::failed) << outcome.error().reason;
    EXPECT_EQ(machine.lasers(), 0);
    EXPECT_EQ(machine.speed(), 0);
    bool second = false;
    for (const auto& [stop, profile] : stopped_profiles(task.log_file)) second |= stop.elevation_rad > 0.1;
    EXPECT_TRUE(second) << "profiles of the turn that was stopped are kept";
  }
}

TEST(ScanAxes, CancelledAtAnyInstantNothingMovesAndNothingShines) {
  const Calibration calibration = FakeMachine(0, 0, true).calibration(1);
  bool whole = false;
  int cut_short = 0;
  for (int instant = 5; !whole; instant += 97) {
    FakeMachine machine(0, 0, true);
    const TemporaryFolder folder;
    const ScanTask task = task_at(folder, {0, 20}, {0, 10});
    ScanOnlooker onlooker;
    onlooker.cancel_at = instant;
    const auto outcome = scan_of(machine, calibration, task, onlooker);
    ASSERT_EQ(machine.lasers(), 0) << instant;
    ASSERT_EQ(machine.speed(), 0) << instant;
    expect_dark_moves(machine);
    whole = outcome.has_value();
    if (whole) continue;
    ++cut_short;
    ASSERT_EQ(outcome.error().state, ScanState::cancelled) << outcome.error().reason;
    if (std::filesystem::exists(task.log_file)) stopped_profiles(task.log_file);
  }
  EXPECT_GT(cut_short, 10);
}

TEST(ScanAxes, ARecordingGivesTheSameSamplesOfEachStop) {
  FakeMachine machine(0, 0, true);
  const TemporaryFolder folder;
  ScanTask task = task_at(folder, {0, 25}, {});
  task.recording_folder = folder / "frames";
  const Calibration calibration = machine.calibration(2);
  ScanOnlooker onlooker;
  const auto outcome = scan_of(machine, calibration, task, onlooker);
  ASSERT_TRUE(outcome) << outcome.error().reason;
  auto recording = open_frame_source("replay:" + (folder / "frames").string());
  ASSERT_TRUE(recording) << recording.error().message;
  EXPECT_EQ((*recording)->recorded()->stops.size(), 2u);
  MonotonicClock clock;
  const ScanEquipment equipment{nullptr, **recording, clock, calibration, nullptr, {}};
  const ScanTask again = task_at(folder, {0, 25}, {}, "again");
  const auto replayed = run_scan(equipment, again, onlooker);
  ASSERT_TRUE(replayed) << replayed.error().reason;
  const auto live = stopped_profiles(task.log_file), same = stopped_profiles(again.log_file);
  ASSERT_EQ(live.size(), same.size());
  for (std::size_t k = 0; k < live.size(); ++k) {
    EXPECT_EQ(live[k].stop, same[k].stop);
    EXPECT_EQ(live[k].profile.laser, same[k].profile.laser);
    EXPECT_EQ(live[k].profile.r_mm, same[k].profile.r_mm);
    EXPECT_EQ(live[k].profile.theta_rad, same[k].profile.theta_rad);
    EXPECT_EQ(live[k].profile.z_mm, same[k].profile.z_mm);
  }
  EXPECT_EQ(testing::read_file(task.results_folder / "surface.json"),
            testing::read_file(again.results_folder / "surface.json"));
}

}  // namespace
}  // namespace celadon
