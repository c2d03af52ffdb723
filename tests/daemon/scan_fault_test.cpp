// Faults of camera and laser that only the host can see, on a machine in closed form.

#include <gtest/gtest.h>

#include <algorithm>
#include <utility>

#include "daemon/profile_log.h"
#include "daemon/scan_job.h"
#include "tests/daemon/fake_machine.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::FakeMachine;
using testing::read_file;
using testing::TemporaryFolder;

/// Does something to the machine when a scan enters a state.
class At final : public ScanObserver {
 public:
  At(ScanState state, std::function<void()> strike) : state_(state), strike_(std::move(strike)) {}
  void on_state(ScanState state) override {
    if (state == state_) strike_();
  }
  void on_progress(const ScanProgress&) override {}
  void on_status(const DeviceStatus& status) override { on_look(status); }
  std::function<void(const DeviceStatus&)> on_look = [](const DeviceStatus&) {};
  std::optional<std::string> cancelled() override { return std::nullopt; }

 private:
  ScanState state_;
  std::function<void()> strike_;
};

struct Told {
  bool done = false;
  std::string text;  ///< reason or warnings
  std::size_t profiles = 0, smallest_profile = 0;
};

Told scan(
    FakeMachine& machine, ScanState state, std::function<void()> strike, ScanMode mode = ScanMode::sweep,
    bool from_afar = false, std::function<void(const DeviceStatus&)> look = [](const DeviceStatus&) {}) {
  const TemporaryFolder folder;
  const Calibration calibration = machine.calibration();
  auto connection = machine.connect(calibration);
  EXPECT_TRUE(connection) << connection.error().message;
  ScanTask task;
  task.request.profiles = 16;
  task.request.mode = mode;
  task.request.formats = {"surface.json"};
  task.date = "2026-01-02T03:04:05Z";
  task.log_file = folder / "profiles.log";
  task.results_folder = folder / "results";
  task.from_afar = from_afar;
  At observer(state, std::move(strike));
  observer.on_look = std::move(look);
  auto outcome = run_scan({connection->device.get(), *connection->camera, *connection->clock, calibration, nullptr, {}},
                          task, observer);
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(machine.speed(), 0);
  Told told;
  told.done = outcome.has_value();
  if (!outcome) told.text = outcome.error().reason;
  for (const std::string& warning : outcome ? outcome->warnings : std::vector<std::string>())
    told.text += warning + " ";
  auto log = ProfileLogReader::open(task.log_file);
  for (const Profile* profile = nullptr; log && (profile = (*log)->next()) != nullptr;) {
    told.smallest_profile = told.profiles == 0 ? profile->size() : std::min(told.smallest_profile, profile->size());
    ++told.profiles;
  }
  return told;
}

::testing::AssertionResult says(const Told& told, bool done, const std::string& words) {
  if (told.done == done && told.text.find(words) != std::string::npos) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << (told.done ? "done: " : "ended: ") << told.text;
}

TEST(ScanFault, ACameraWhoseFramesAreAllDamagedEndsTheScan) {
  for (const ScanState state : {ScanState::preparing, ScanState::scanning}) {
    for (const ScanMode mode : {ScanMode::sweep, ScanMode::step}) {
      FakeMachine machine;
      EXPECT_TRUE(says(scan(
                           machine, state, [&] { machine.corrupt_every = 1; }, mode),
                       false, "damaged"));
    }
  }
}

TEST(ScanFault, StampsThatCannotBeEndTheScan) {
  FakeMachine ahead, back;
  EXPECT_TRUE(says(scan(ahead, ScanState::scanning, [&] { ahead.stamp_step_us = 400'000; }), false, "in the future"));
  EXPECT_TRUE(says(scan(back, ScanState::scanning, [&] { back.stamp_step_us = -400'000; }), false, "older"));
}

TEST(ScanFault, ALaserThatDoesNotEmitIsNamed) {
  for (const ScanState state : {ScanState::preparing, ScanState::scanning}) {
    FakeMachine machine;
    const auto die = [&] { machine.with_plant([](test::TestPlant& p) { p.dead_lasers = 1; }); };
    EXPECT_TRUE(says(scan(machine, state, die), false, "does not emit although it is switched on"));
  }
}

// The lease of half a second ends before every second frame: no profile may be taken in the dark.
TEST(ScanFault, FramesOfALaserWhoseLeaseRanOutAreTakenAgain) {
  FakeMachine steps, turns;
  const Told stepped = scan(
      steps, ScanState::scanning, [&] { steps.late_us = 1'500'000; }, ScanMode::step);
  EXPECT_TRUE(says(stepped, true, "lease had run out"));
  EXPECT_EQ(stepped.profiles, 16u);
  EXPECT_GT(stepped.smallest_profile, 100u);
  // A sweep goes on; what it takes was lit.
  const Told swept = scan(turns, ScanState::scanning, [&] { turns.late_us = 520'000; });
  EXPECT_GT(swept.profiles, 0u);
  EXPECT_GT(swept.smallest_profile, 100u);
}

// A frame right after a move may still be lit by chance; not so every one of a sweep.
TEST(ScanFault, FramesThatAllComeAfterTheLeaseEndTheScan) {
  FakeMachine before, sweeping;
  before.all_late = sweeping.all_late = true;
  EXPECT_TRUE(says(scan(before, ScanState::preparing, [&] { before.late_us = 1'500'000; }), false,
                   "lease of 500 ms had run out"));
  EXPECT_TRUE(says(scan(sweeping, ScanState::scanning, [&] { sweeping.late_us = 700'000; }), false,
                   "lease of 500 ms had run out"));
}

TEST(ScanFault, ALaserThatShinesUnseenByItsSensorIsFoundInAFrame) {
  FakeMachine before, while_scanning, good;
  EXPECT_TRUE(says(scan(before, ScanState::preparing, [&] { before.laser_hidden = true; }), false,
                   "emits although it is switched off"));
  EXPECT_TRUE(says(scan(while_scanning, ScanState::scanning, [&] { while_scanning.laser_hidden = true; }), true,
                   "emits although it is switched off"));
  const Told fine = scan(good, ScanState::scanning, [] {});
  EXPECT_TRUE(fine.done);
  EXPECT_EQ(fine.text.find("emits"), std::string::npos) << fine.text;
}

TEST(ScanStart, FromAfarIsForbiddenByTheSwitchAtTheMachine) {
  FakeMachine machine;
  const auto forbid = [&] { machine.with_plant([](test::TestPlant& p) { p.remote_enabled = false; }); };
  EXPECT_TRUE(says(scan(machine, ScanState::preparing, forbid, ScanMode::sweep, true), false, "forbids a start"));
  machine.with_plant([](test::TestPlant& p) { EXPECT_EQ(p.homes, 0); });
  EXPECT_TRUE(scan(machine, ScanState::preparing, forbid).done);  // by the button it is allowed
}

TEST(ScanStart, FromAfarNothingMovesOrShinesForTwoSecondsOfWarning) {
  for (const bool from_afar : {false, true}) {
    FakeMachine machine;
    std::int64_t asked_ns = 0;
    const Told told = scan(
        machine, ScanState::preparing, [&] { asked_ns = machine.now_ns(); }, ScanMode::sweep, from_afar);
    EXPECT_TRUE(told.done) << told.text;
    machine.with_plant([&](test::TestPlant& p) {
      const auto shone =
          std::find_if(p.laser_log.begin(), p.laser_log.end(), [](const auto& e) { return e.second != 0; });
      ASSERT_NE(shone, p.laser_log.end());
      const auto waited_ns = [&](std::uint64_t at_us) {
        return static_cast<std::int64_t>(at_us) * 1000 + FakeMachine::kHostOffset_ns - asked_ns;
      };
      EXPECT_EQ(waited_ns(p.first_start_us) >= 2'000'000'000, from_afar);
      EXPECT_LE(waited_ns(p.first_start_us), waited_ns(shone->first));
      EXPECT_LT(waited_ns(p.first_start_us), 2'200'000'000);
    });
  }
}

TEST(ScanStart, TheWarningEndsWithThePressOfWhoeverStandsThere) {
  FakeMachine machine;
  bool pressed = false;
  const auto press = [&](const DeviceStatus&) {
    if (!std::exchange(pressed, true)) machine.press_button();
  };
  EXPECT_TRUE(says(scan(
                       machine, ScanState::idle, [] {}, ScanMode::sweep, true, press),
                   false, "by the button"));
  machine.with_plant([](test::TestPlant& p) { EXPECT_EQ(p.homes, 0); });
}

}  // namespace
}  // namespace celadon
