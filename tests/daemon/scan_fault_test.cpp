// Faults of camera and laser that only the host can see, on a machine in closed form.

#include <gtest/gtest.h>

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
  void on_status(const DeviceStatus&) override {}
  std::optional<std::string> cancelled() override { return std::nullopt; }

 private:
  ScanState state_;
  std::function<void()> strike_;
};

struct Told {
  bool done = false;
  std::string text;  ///< reason or warnings
};

Told scan(FakeMachine& machine, ScanState state, std::function<void()> strike, ScanMode mode = ScanMode::sweep) {
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
  At observer(state, std::move(strike));
  auto outcome = run_scan({connection->device.get(), *connection->camera, *connection->clock, calibration, nullptr, {}},
                          task, observer);
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(machine.speed(), 0);
  if (!outcome) return {false, outcome.error().reason};
  Told told{true, ""};
  for (const std::string& warning : outcome->warnings) told.text += warning + " ";
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

}  // namespace
}  // namespace celadon
