// Scans with the exposure auto on a machine in closed form: what is covered, how well, and how the machine is left.

#include <gtest/gtest.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <set>

#include "daemon/profile_log.h"
#include "daemon/scan_job.h"
#include "tests/daemon/fake_machine.h"
#include "tests/daemon/scan_onlooker.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::FakeMachine;
using testing::TemporaryFolder;

constexpr std::int64_t kFound_us = FakeMachine::kExposure_us;

/// A third of the turn so dark that 4 ms do not show it.
double dark_third(double theta_rad, double) {
  const double turns = theta_rad / (2 * std::numbers::pi);
  return turns - std::floor(turns) < 1. / 3 ? 0.03 : 1;
}

/// Bright and dark in each profile, more than one exposure can hold.
double bands(double, double z_mm) {
  return std::fmod(z_mm, 24) < 12 ? 1 : 0.03;
}

ScanTask task_in(const TemporaryFolder& folder, ScanMode mode, double exposure_ms = -1) {
  ScanTask task;
  task.request.profiles = 72;
  task.request.mode = mode;
  task.request.exposure_auto = exposure_ms < 0;
  task.request.exposure_ms = std::max(exposure_ms, 0.);
  task.request.formats = {"surface.json"};
  task.date = "2026-01-02T03:04:05Z";
  task.log_file = folder / "profiles.log";
  task.results_folder = folder / "results";
  return task;
}

tl::expected<ScanOutcome, ScanStop> scan_on(FakeMachine& machine, const ScanTask& task, ScanObserver& observer,
                                            int lasers = 1) {
  const Calibration calibration = machine.calibration(lasers);
  auto connection = machine.connect(calibration);
  EXPECT_TRUE(connection) << connection.error().message;
  auto outcome = run_scan({connection->device.get(), *connection->camera, *connection->clock, calibration, nullptr, {}},
                          task, observer);
  // On every way out, while the camera is still open for the next scan.
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(machine.speed(), 0);
  return outcome;
}

/// What a log's samples cover of the object, in cells of 10 degrees and 5 mm, and how far off the truth they are.
struct Seen {
  double covered = 0, rms_mm = 0, largest_mm = 0;
  std::size_t samples = 0;
};
Seen seen_in(const std::filesystem::path& log_file) {
  constexpr double kLow_mm = 10, kHigh_mm = 95, kCell_mm = 5;
  constexpr int kAround = 36, kAlong = 17;
  std::set<int> cells;
  Seen seen;
  auto log = ProfileLogReader::open(log_file);
  EXPECT_TRUE(log) << log.error().message;
  double squares = 0;
  while (const Profile* p = (*log)->next()) {
    for (std::size_t i = 0; i < p->size(); ++i) {
      if (p->z_mm[i] < kLow_mm || p->z_mm[i] >= kHigh_mm) continue;
      const double off = p->r_mm[i] - FakeMachine::vase(p->theta_rad[i], p->z_mm[i]);
      squares += off * off;
      seen.largest_mm = std::max(seen.largest_mm, std::abs(off));
      ++seen.samples;
      const double turns = p->theta_rad[i] / (2 * std::numbers::pi);
      cells.insert(static_cast<int>((turns - std::floor(turns)) * kAround) * kAlong +
                   static_cast<int>((p->z_mm[i] - kLow_mm) / kCell_mm));
    }
  }
  seen.covered = static_cast<double>(cells.size()) / (kAround * kAlong);
  seen.rms_mm = std::sqrt(squares / static_cast<double>(std::max<std::size_t>(seen.samples, 1)));
  return seen;
}

nlohmann::json report_of(const ScanTask& task) {
  return nlohmann::json::parse(testing::read_file(task.results_folder / "report.json"));
}

Seen scan_at(const std::function<double(double, double)>& reflectance, ScanMode mode, double exposure_ms) {
  FakeMachine machine;
  machine.reflectance = reflectance;
  const TemporaryFolder folder;
  ScanTask task = task_in(folder, mode, exposure_ms);
  task.request.shape = "none";
  ScanOnlooker watcher;
  const auto outcome = scan_on(machine, task, watcher);
  EXPECT_TRUE(outcome) << outcome.error().reason;
  return outcome ? seen_in(task.log_file) : Seen();
}

TEST(ScanExposure, ADarkThirdIsCoveredByAutoAndNotByAFixedExposure) {
  EXPECT_LT(scan_at(dark_third, ScanMode::sweep, 4).covered, 0.7);
  for (const ScanMode mode : {ScanMode::sweep, ScanMode::step}) {
    FakeMachine machine;
    machine.reflectance = dark_third;
    const TemporaryFolder folder;
    const ScanTask task = task_in(folder, mode);
    ScanOnlooker watcher;
    const auto outcome = scan_on(machine, task, watcher);
    ASSERT_TRUE(outcome) << outcome.error().reason;
    const Seen seen = seen_in(task.log_file);
    EXPECT_GT(seen.covered, 0.97);
    EXPECT_LT(seen.rms_mm, 0.1);
    EXPECT_LT(seen.largest_mm, 0.6);
    const auto report = report_of(task);
    // Steps change the exposure within the turn; a sweep has one, and turns twice.
    const bool swept = mode == ScanMode::sweep;
    EXPECT_EQ(report["exposures"]["bracketed"], swept);
    ASSERT_EQ(report["exposures"]["turns"].size(), swept ? 2u : 1u);
    const auto& stretches = report["exposures"]["turns"].back()["stretches"];
    ASSERT_EQ(stretches.size(), 2u) << stretches;
    const auto darker = std::max_element(stretches.begin(), stretches.end(), [](const auto& a, const auto& b) {
      return a["exposure_ms"].template get<double>() < b["exposure_ms"].template get<double>();
    });
    EXPECT_NEAR((*darker)["to_deg"].get<double>() - (*darker)["from_deg"].get<double>(), swept ? 130 : 120, 10);
    EXPECT_GT((*darker)["exposure_ms"], 15);
    EXPECT_EQ(machine.exposure_us, kFound_us) << "put back while the camera is open";
    EXPECT_TRUE(std::is_sorted(watcher.fractions.begin(), watcher.fractions.end()));
  }
}

TEST(ScanExposure, BrightAndDarkBandsAreCoveredByTwoTurns) {
  const Seen shorter = scan_at(bands, ScanMode::sweep, 4.75);
  EXPECT_LT(shorter.covered, 0.7);
  for (const ScanMode mode : {ScanMode::sweep, ScanMode::step}) {
    FakeMachine machine;
    machine.reflectance = bands;
    const TemporaryFolder folder;
    const ScanTask task = task_in(folder, mode);
    ScanOnlooker watcher;
    const auto outcome = scan_on(machine, task, watcher);
    ASSERT_TRUE(outcome) << outcome.error().reason;
    const auto report = report_of(task);
    EXPECT_EQ(report["exposures"]["bracketed"], true);
    ASSERT_EQ(report["lasers"].size(), 2u);
    EXPECT_EQ(report["lasers"][1]["laser"], 0);
    const Seen both = seen_in(task.log_file);
    EXPECT_GT(both.covered, 0.97);
    EXPECT_LT(both.rms_mm, 0.12);
    EXPECT_EQ(watcher.progress.fraction, 1);
    EXPECT_TRUE(std::is_sorted(watcher.fractions.begin(), watcher.fractions.end()));
    EXPECT_EQ(machine.exposure_us, kFound_us);
  }
}

// A turn with each laser, and with each of its exposures.
TEST(ScanExposure, EachLaserHasItsOwnTurns) {
  FakeMachine machine;
  machine.reflectance = bands;
  const TemporaryFolder folder;
  const ScanTask task = task_in(folder, ScanMode::sweep);
  ScanOnlooker watcher;
  const auto outcome = scan_on(machine, task, watcher, 2);
  ASSERT_TRUE(outcome) << outcome.error().reason;
  const auto report = report_of(task);
  ASSERT_EQ(report["lasers"].size(), 4u);
  for (const std::size_t k : {0u, 1u, 2u, 3u}) {
    EXPECT_EQ(report["lasers"][k]["laser"], k / 2);
    EXPECT_EQ(report["exposures"]["turns"][k]["laser"], k / 2);
  }
  EXPECT_GT(seen_in(task.log_file).covered, 0.97);
}

// The camera takes a new exposure five frames later and cannot say when: such frames are left out, those kept have the
// exposure that the log says, on which their instant and their background depend.
TEST(ScanExposure, FramesAcrossAChangeAreNotMisjudged) {
  for (const ScanMode mode : {ScanMode::sweep, ScanMode::step}) {
    FakeMachine machine;
    machine.reflectance = dark_third;
    machine.exposure_late = 5;
    const TemporaryFolder folder;
    const ScanTask task = task_in(folder, mode);
    ScanOnlooker watcher;
    const auto outcome = scan_on(machine, task, watcher);
    ASSERT_TRUE(outcome) << outcome.error().reason;
    const auto true_us = machine.exposures_us();
    int kept = 0, stale = 0;
    auto log = ProfileLogReader::open(task.log_file);
    ASSERT_TRUE(log);
    while (const auto entry = (*log)->next_entry()) {
      const auto* frame = std::get_if<LogFrame>(&*entry);
      if (frame == nullptr) continue;
      stale += frame->verdict == FrameVerdict::stale;
      if (frame->verdict != FrameVerdict::profile) continue;
      ++kept;
      EXPECT_EQ(frame->exposure_ns, true_us.at(frame->sequence) * 1000) << frame->sequence;
    }
    EXPECT_GT(kept, 50);
    EXPECT_GT(stale, 3);
    const Seen seen = seen_in(task.log_file);
    EXPECT_LT(seen.rms_mm, 0.1);
    if (mode == ScanMode::step) {
      EXPECT_GT(seen.covered, 0.97) << "a table that stands waits for the camera";
    }
  }
}

// A line many times too bright shines where it is not: of the longer turn only what is beside the dark third counts.
TEST(ScanExposure, NoBrightPlaceIsExposedForTheDarkOnes) {
  FakeMachine machine;
  machine.reflectance = dark_third;
  const TemporaryFolder folder;
  const ScanTask task = task_in(folder, ScanMode::sweep);
  ScanOnlooker watcher;
  const auto outcome = scan_on(machine, task, watcher);
  ASSERT_TRUE(outcome) << outcome.error().reason;
  auto log = ProfileLogReader::open(task.log_file);
  ASSERT_TRUE(log);
  std::int64_t exposure_ns = 0;
  int bright = 0, dark = 0, glaring = 0;
  while (const auto entry = (*log)->next_entry()) {
    if (const auto* frame = std::get_if<LogFrame>(&*entry); frame != nullptr && frame->verdict == FrameVerdict::profile)
      exposure_ns = frame->exposure_ns;
    const auto* logged = std::get_if<LoggedProfile>(&*entry);
    if (logged == nullptr || logged->profile->size() == 0) continue;
    constexpr double kBeside_rad = 15 * std::numbers::pi / 180;
    const double theta_rad = logged->profile->theta_rad[0];
    const bool is_dark = std::min({dark_third(theta_rad, 0), dark_third(theta_rad - kBeside_rad, 0),
                                   dark_third(theta_rad + kBeside_rad, 0)}) < 1;
    ++(is_dark ? dark : bright);
    glaring += !is_dark && exposure_ns > 2 * FakeMachine::kExposure_us * 1000;
  }
  EXPECT_GT(bright, 40);
  EXPECT_GT(dark, 15);
  EXPECT_EQ(glaring, 0);
}

TEST(ScanExposure, CoarseControlsDo) {
  FakeMachine machine;
  machine.reflectance = dark_third;
  machine.exposure_unit_us = 1000;
  const TemporaryFolder folder;
  const ScanTask task = task_in(folder, ScanMode::sweep);
  ScanOnlooker watcher;
  const auto outcome = scan_on(machine, task, watcher);
  ASSERT_TRUE(outcome) << outcome.error().reason;
  const Seen seen = seen_in(task.log_file);
  EXPECT_GT(seen.covered, 0.97);
  EXPECT_LT(seen.rms_mm, 0.1);
}

TEST(ScanExposure, ACameraThatTakesNoExposureIsRefusedInOneSentence) {
  for (const bool keeps : {false, true}) {
    FakeMachine machine;
    machine.exposure_fixed = keeps;
    machine.exposure_refusal = keeps ? 0 : EINVAL;
    const TemporaryFolder folder;
    const ScanTask task = task_in(folder, ScanMode::sweep);
    ScanOnlooker watcher;
    const auto outcome = scan_on(machine, task, watcher);
    ASSERT_FALSE(outcome);
    EXPECT_EQ(outcome.error().state, ScanState::failed);
    EXPECT_FALSE(outcome.error().camera_lost) << "it works otherwise";
    const std::string& reason = outcome.error().reason;
    EXPECT_NE(reason.find(keeps ? "The camera keeps its exposure of 4 ms whatever is asked for (2.38 ms and 19 ms)"
                                : "needs a camera whose exposure can be set"),
              std::string::npos)
        << reason;
    EXPECT_NE(reason.find(keeps ? "scan with the exposure 0" : "errno 22"), std::string::npos) << reason;
    EXPECT_FALSE(std::filesystem::exists(task.log_file));
  }
}

// Whichever attempt the camera refuses, in the quick turns, before the turn or within it.
TEST(ScanExposure, ARefusalAtAnyMomentLeavesTheMachineAsItWas) {
  int refused = 0, during_turn = 0;
  bool whole = false;
  for (int takes = 0; !whole; ++takes) {
    FakeMachine machine;
    machine.reflectance = dark_third;
    machine.exposure_takes = takes;
    const TemporaryFolder folder;
    ScanTask task = task_in(folder, takes % 2 == 0 ? ScanMode::sweep : ScanMode::step);
    task.request.profiles = 24;
    ScanOnlooker watcher;
    const auto outcome = scan_on(machine, task, watcher);
    whole = outcome.has_value();
    // The last attempt of all is the one that puts it back.
    if (whole) break;
    EXPECT_EQ(machine.exposure_us, kFound_us) << takes;
    EXPECT_NE(outcome.error().reason.find("errno 5"), std::string::npos) << outcome.error().reason;
    ++refused;
    during_turn += std::filesystem::exists(task.log_file);
  }
  EXPECT_GT(refused, 5);
  EXPECT_GT(during_turn, 0);
}

TEST(ScanExposure, CancelledAtAnyInstantItIsSafeAndTheExposureIsPutBack) {
  bool whole = false;
  int cut_short = 0;
  for (int instant = 3; !whole; instant += 211) {
    FakeMachine machine;
    machine.reflectance = bands;
    const TemporaryFolder folder;
    ScanTask task = task_in(folder, instant % 2 == 0 ? ScanMode::sweep : ScanMode::step);
    task.request.profiles = 24;
    ScanOnlooker watcher;
    watcher.cancel_at = instant;
    const auto outcome = scan_on(machine, task, watcher);
    ASSERT_EQ(machine.exposure_us, kFound_us) << instant;
    whole = outcome.has_value();
    if (whole) continue;
    ++cut_short;
    ASSERT_EQ(outcome.error().state, ScanState::cancelled) << outcome.error().reason;
  }
  EXPECT_GT(cut_short, 10);
}

TEST(ScanExposure, FaultsWhileExposuresChangeEndTheScanSafely) {
  struct Fault {
    const char* words;
    std::function<void(FakeMachine&)> strike, mend;
  };
  const Fault faults[] = {
      {"unplugged", [](FakeMachine& m) { m.camera_unplugged = true; },
       [](FakeMachine& m) { m.camera_unplugged = false; }},
      {"no frame for", [](FakeMachine& m) { m.camera_silent = true; }, [](FakeMachine& m) { m.camera_silent = false; }},
      {"damaged ones", [](FakeMachine& m) { m.corrupt_every = 1; }, [](FakeMachine& m) { m.corrupt_every = 0; }}};
  for (const Fault& fault : faults) {
    FakeMachine machine;
    machine.reflectance = dark_third;
    const TemporaryFolder folder;
    ScanTask task = task_in(folder, ScanMode::sweep);
    ScanOnlooker watcher;
    watcher.at_progress = [&](const ScanProgress& now) {
      if (now.fraction > 0.3) fault.strike(machine);
    };
    const auto outcome = scan_on(machine, task, watcher);
    ASSERT_FALSE(outcome) << fault.words;
    EXPECT_NE(outcome.error().reason.find(fault.words), std::string::npos) << outcome.error().reason;
    fault.mend(machine);
  }
  // Frames that are damaged now and then are left out, whatever the exposure.
  FakeMachine machine;
  machine.reflectance = dark_third;
  machine.corrupt_every = 7;
  const TemporaryFolder folder;
  const ScanTask task = task_in(folder, ScanMode::sweep);
  ScanOnlooker watcher;
  const auto outcome = scan_on(machine, task, watcher);
  ASSERT_TRUE(outcome) << outcome.error().reason;
  EXPECT_LT(seen_in(task.log_file).rms_mm, 0.1);
}

TEST(ScanExposure, AFixedExposureIsPutBackToo) {
  FakeMachine machine;
  const TemporaryFolder folder;
  const ScanTask task = task_in(folder, ScanMode::sweep, 3);
  ScanOnlooker watcher;
  ASSERT_TRUE(scan_on(machine, task, watcher));
  EXPECT_EQ(machine.exposure_us, kFound_us);
  const auto exposures = machine.exposures_us();
  EXPECT_NE(std::find(exposures.begin(), exposures.end(), 3000), exposures.end());
}

TEST(ScanExposure, ATableWithoutEndlessTurnsGoesBackOrSaysThatItCannot) {
  for (const double travel_deg : {950., 300.}) {
    FakeMachine machine(0, travel_deg);
    machine.reflectance = bands;
    const TemporaryFolder folder;
    const ScanTask task = task_in(folder, ScanMode::step);
    ScanOnlooker watcher;
    const auto outcome = scan_on(machine, task, watcher);
    EXPECT_EQ(outcome.has_value(), travel_deg > 900) << outcome.error().reason;
    if (!outcome) {
      EXPECT_NE(outcome.error().reason.find("The quick turn that finds the exposure needs the table to turn to"),
                std::string::npos)
          << outcome.error().reason;
    }
  }
}

}  // namespace
}  // namespace celadon
