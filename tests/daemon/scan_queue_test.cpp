// The queue and the whole scan path on a machine in closed form: through the real device, extraction, fit and files.

#include "daemon/scan_queue.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <mutex>

#include <nlohmann/json.hpp>

#include "daemon/profile_log.h"
#include "daemon/surface_json.h"
#include "tests/daemon/fake_machine.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::FakeMachine;
using testing::read_file;
using testing::TemporaryFolder;

ScanRequest quick_request() {
  ScanRequest request;
  request.name = "test vase";
  request.profiles = 120;
  request.formats = {"stl", "ply", "surface.json"};  // no STEP: its helper process is tested elsewhere
  return request;
}

/// For what is to happen in the middle of a scan, however late the test's own thread gets to it.
ScanRequest long_request() {
  ScanRequest request = quick_request();
  request.profiles = 3000;
  return request;
}

constexpr std::chrono::milliseconds kPollPeriod{1};

/// A queue on a fake machine, and what it told its listener.
class Bench {
 public:
  explicit Bench(FakeMachine& machine) : Bench(machine, machine.calibration()) {}
  Bench(FakeMachine& machine, const Calibration& calibration, std::chrono::nanoseconds poll = kPollPeriod,
        std::chrono::nanoseconds retry = std::chrono::milliseconds(1))
      : machine_(machine), calibration_(calibration), poll_period_(poll), retry_(retry) {
    open();
  }

  ~Bench() { queue.reset(); }  // before what its listener uses

  void open() {
    auto store = ScanStore::open(folder / "store");
    if (!store) throw std::runtime_error(store.error().message);
    ScanQueueOptions options;
    options.button_request = quick_request();
    options.poll_period = poll_period_;
    options.first_retry = options.longest_retry = retry_;
    queue = std::make_unique<ScanQueue>(std::move(*store), calibration_, options,
                                        [this](const auto&) { return machine_.connect(calibration_); });
    queue->subscribe([this, q = queue.get()](std::uint64_t id) {
      const ScanRecord record = *q->scan(id);
      const std::lock_guard lock(mutex_);
      // Whether `queued` is seen depends on which thread comes first.
      const bool news = seen_.empty() || seen_.back() != record.state;
      if (news && record.state != ScanState::queued) seen_.push_back(record.state);
      frames_ = record.progress.frames;
      last_ = record;
      changed_.notify_all();
    });
  }
  /// Waits, without polling, for a state of any scan.
  ScanRecord wait_for(ScanState state, int frames = 0) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return (last_.state == state && frames_ >= frames) || is_final(last_.state); });
    return last_;
  }
  ScanRecord wait_for_end() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return is_final(last_.state); });
    return last_;
  }
  std::vector<ScanState> states() {
    const std::lock_guard lock(mutex_);
    return seen_;
  }
  void forget() {
    const std::lock_guard lock(mutex_);
    last_ = {};
    seen_.clear();
    frames_ = 0;
  }

  TemporaryFolder folder;
  std::unique_ptr<ScanQueue> queue;

 private:
  FakeMachine& machine_;
  const Calibration calibration_;
  const std::chrono::nanoseconds poll_period_, retry_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<ScanState> seen_;
  ScanRecord last_;
  int frames_ = 0;
};

nlohmann::json report_of(const ScanRecord& record) {
  return nlohmann::json::parse(read_file(record.folder / "report.json"));
}

/// RMS of the fitted range against the closed form of the object.
double error_against(const FakeMachine& machine, const ScanRecord& record) {
  const auto file = read_surface_json(record.folder / "surface.json");
  EXPECT_TRUE(file) << file.error();
  double squares = 0;
  int n = 0;
  for (double z = 12; z < 95; z += 3.7) {
    for (double theta = 0.05; theta < 6.28; theta += 0.1) {
      const double e = file->pieces.front().function(theta, z) - machine.shape(theta, z);
      squares += e * e;
      ++n;
    }
  }
  return std::sqrt(squares / n);
}

TEST(ScanQueue, SweepLeavesFilesThatAgreeWithTheObject) {
  FakeMachine machine;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  const auto submitted = bench.queue->submit(quick_request(), "api");
  ASSERT_TRUE(submitted) << submitted.error().detail;
  EXPECT_EQ(submitted->id, 1u);
  const ScanRecord record = bench.wait_for_end();
  ASSERT_EQ(record.state, ScanState::done) << record.reason;
  EXPECT_EQ(bench.states(), (std::vector{ScanState::preparing, ScanState::scanning, ScanState::solving,
                                         ScanState::exporting, ScanState::done}));
  EXPECT_EQ(record.files,
            (std::vector<std::string>{"test_vase.stl", "test_vase.ply", "surface.json", "errors.svg", "report.json"}));
  EXPECT_LT(error_against(machine, record), 0.03);
  const auto report = report_of(record);
  EXPECT_EQ(report["model"], "general");
  EXPECT_EQ(report["simulated"], true);
  EXPECT_EQ(report["scan"]["mode"], "sweep");
  EXPECT_NEAR(report["scan"]["profiles"].get<double>(), 120, 1);
  EXPECT_EQ(report["scan"]["lost"], 0);
  EXPECT_LT(report["closure_mm"]["rms"].get<double>(), 0.3);
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(machine.speed(), 0);
  auto log = ProfileLogReader::open(bench.folder / "store/scans/000001/profiles.log");
  ASSERT_TRUE(log);
  while ((*log)->next() != nullptr) {
  }
  ASSERT_TRUE((*log)->end());
  EXPECT_EQ((*log)->end()->outcome, LogOutcome::complete);
  EXPECT_EQ((*log)->end()->profiles, report["scan"]["profiles"]);
}

TEST(ScanQueue, StepModeDropsStaleFramesAndSeesTheSameObject) {
  FakeMachine machine;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  ScanRequest request = quick_request();
  request.mode = ScanMode::step;
  ASSERT_TRUE(bench.queue->submit(request, "api"));
  const ScanRecord record = bench.wait_for_end();
  ASSERT_EQ(record.state, ScanState::done) << record.reason;
  // The driver's queue is full of frames from the move after each step: one that was taken for fresh would stand
  // four degrees beside its place.
  EXPECT_LT(error_against(machine, record), 0.03);
  const auto report = report_of(record);
  EXPECT_EQ(report["scan"]["profiles"], 120);
  EXPECT_GT(report["scan"]["stale"], 120);
  EXPECT_EQ(report["scan"]["lost"], 0);
}

TEST(ScanQueue, ASlippingTableIsToldByTheClosureTest) {
  FakeMachine machine;
  machine.slip_per_turn_deg = 6;
  machine.shape = [](double theta, double z) { return z < 5 || z > 100 ? 0 : 30 + 6 * std::cos(theta); };
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  ASSERT_TRUE(bench.queue->submit(quick_request(), "api"));
  const ScanRecord record = bench.wait_for_end();
  ASSERT_EQ(record.state, ScanState::done) << record.reason;
  const auto scatter = std::find_if(record.checks.begin(), record.checks.end(),
                                    [](const SelfCheck& check) { return check.name == "closure_scatter"; });
  ASSERT_NE(scatter, record.checks.end());
  EXPECT_EQ(scatter->verdict, CheckVerdict::failed) << report_of(record).dump(2);
  EXPECT_EQ(report_of(record)["checks"].size(), record.checks.size());
}

TEST(ScanQueue, APressThatTheMachineTellsOfIsNotWaitedFor) {
  FakeMachine machine;
  machine.tells_changes = true;
  Bench bench(machine, machine.calibration(), std::chrono::hours(1));
  ASSERT_TRUE(bench.queue->start());
  machine.press_button();
  bench.wait_for(ScanState::scanning, 3);
  ASSERT_TRUE(bench.queue->cancel(1));
  EXPECT_EQ(bench.wait_for_end().requested_by, "button");
}

TEST(ScanQueue, ButtonStartsAndASecondPressStops) {
  FakeMachine machine;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  machine.press_button();
  bench.wait_for(ScanState::scanning, 3);
  EXPECT_EQ(machine.lamp(), LampPattern::busy);
  machine.press_button();
  const ScanRecord record = bench.wait_for_end();
  EXPECT_EQ(record.requested_by, "button");
  EXPECT_EQ(record.state, ScanState::cancelled);
  EXPECT_NE(record.reason.find("button"), std::string::npos) << record.reason;
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(machine.speed(), 0);
  auto log = ProfileLogReader::open(bench.folder / "store/scans/000001/profiles.log");
  ASSERT_TRUE(log);
  int kept = 0;
  while ((*log)->next() != nullptr) ++kept;
  EXPECT_GE(kept, 3);
  EXPECT_EQ((*log)->end()->outcome, LogOutcome::cancelled);
  EXPECT_FALSE(std::filesystem::exists(record.folder));
}

TEST(ScanQueue, CancelEndsARunningScanAndAWaitingOne) {
  FakeMachine machine;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  ASSERT_TRUE(bench.queue->submit(long_request(), "api"));
  bench.wait_for(ScanState::scanning, 3);
  const auto waiting = bench.queue->submit(quick_request(), "api");
  ASSERT_TRUE(waiting);
  ASSERT_TRUE(bench.queue->cancel(waiting->id));
  EXPECT_EQ(bench.queue->scan(waiting->id)->state, ScanState::cancelled);
  ASSERT_TRUE(bench.queue->cancel(1));
  while (!is_final(bench.queue->scan(1)->state)) bench.wait_for_end();
  EXPECT_EQ(bench.queue->scan(1)->state, ScanState::cancelled);
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(bench.queue->cancel(1).error().status, 409);
  EXPECT_EQ(bench.queue->cancel(99).error().status, 404);
}

TEST(ScanQueue, EveryFaultInAScanLeavesTheLaserOffAndASentence) {
  struct Case {
    const char* name;
    std::function<void(FakeMachine&)> harm;
    const char* says;
  };
  const Case cases[] = {
      {"silent camera", [](FakeMachine& m) { m.camera_silent = true; }, "no frame"},
      {"unplugged camera", [](FakeMachine& m) { m.camera_unplugged = true; }, "unplugged"},
      {"interlock", [](FakeMachine& m) { m.with_plant([](auto& p) { p.interlock_closed = false; }); }, "interlock"},
      {"emergency stop", [](FakeMachine& m) { m.with_plant([](auto& p) { p.emergency_stop = true; }); },
       "emergency stop"},
      {"stalled motor", [](FakeMachine& m) { m.with_plant([](auto& p) { p.axis_fault = FaultCode::motor_stalled; }); },
       "fault"},
      {"cable", [](FakeMachine& m) { m.link_down = true; }, "cable cut"},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.name);
    FakeMachine machine;
    Bench bench(machine);
    ASSERT_TRUE(bench.queue->start());
    ASSERT_TRUE(bench.queue->submit(long_request(), "api"));
    bench.wait_for(ScanState::scanning, 3);
    c.harm(machine);
    const ScanRecord record = bench.wait_for_end();
    EXPECT_EQ(record.state, ScanState::failed);
    EXPECT_NE(record.reason.find(c.says), std::string::npos) << record.reason;
    bench.queue->stop();
    machine.advance_to_us(static_cast<std::uint64_t>(machine.now_ns() / 1000) +
                          2'000'000);  // of device time: the lease
    EXPECT_EQ(machine.lasers(), 0);
    EXPECT_EQ(machine.speed(), 0);
    EXPECT_TRUE(std::filesystem::exists(bench.folder / "store/scans/000001/profiles.log"));
    EXPECT_FALSE(std::filesystem::exists(record.folder));
  }
}

TEST(ScanQueue, NothingToSeeIsASentence) {
  FakeMachine machine;
  machine.camera_dark = true;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  ASSERT_TRUE(bench.queue->submit(quick_request(), "api"));
  const ScanRecord record = bench.wait_for_end();
  EXPECT_EQ(record.state, ScanState::failed);
  EXPECT_NE(record.reason.find("No laser line"), std::string::npos) << record.reason;
  EXPECT_EQ(machine.lasers(), 0);
}

TEST(ScanQueue, CorruptFramesAreCountedAndLeftOut) {
  FakeMachine machine;
  machine.corrupt_every = 5;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  ASSERT_TRUE(bench.queue->submit(quick_request(), "api"));
  const ScanRecord record = bench.wait_for_end();
  ASSERT_EQ(record.state, ScanState::done) << record.reason;
  const auto report = report_of(record);
  EXPECT_GT(report["scan"]["corrupt"], 15);
  EXPECT_NE(report["warnings"].dump().find("corrupt"), std::string::npos);
}

TEST(ScanQueue, AnOldCalibrationIsSaidByMachineAndReport) {
  FakeMachine machine;
  Calibration calibration = machine.calibration();
  calibration.date = "2020-02-03";
  Bench bench(machine, calibration);
  ASSERT_TRUE(bench.queue->start());
  const MachineState state = bench.queue->machine();
  EXPECT_EQ(state.calibrated, "2020-02-03");
  ASSERT_EQ(state.calibration_due.size(), 1u);
  ASSERT_TRUE(bench.queue->submit(quick_request(), "api"));
  const ScanRecord record = bench.wait_for_end();
  ASSERT_EQ(record.state, ScanState::done) << record.reason;
  EXPECT_NE(report_of(record)["warnings"].dump().find("The calibration of 2020-02-03 is "), std::string::npos);
}

TEST(ScanQueue, ADryTurnLeavesAReportAlone) {
  FakeMachine machine;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  ScanRequest request = quick_request();
  request.dry_turn = true;
  request.profiles = 2400;
  ASSERT_TRUE(bench.queue->submit(request, "api"));
  const ScanRecord record = bench.wait_for_end();
  ASSERT_EQ(record.state, ScanState::done) << record.reason;
  EXPECT_EQ(record.files, (std::vector<std::string>{"errors.svg", "report.json"}));
  const auto report = report_of(record);
  EXPECT_LT(report["scan"]["profiles"], kDryProfiles + 10);
  const auto& dry = report["dry_turn"];
  EXPECT_EQ(dry["profiles"], 2400);
  EXPECT_EQ(dry["sectors"].size(), 24u);
  EXPECT_NEAR(dry["sd_mm"].get<double>(), report["sd_mm"]["mean"].get<double>() / 5, 1e-9);
  EXPECT_GT(dry["seconds"], 0);
  EXPECT_EQ(std::count_if(record.checks.begin(), record.checks.end(),
                          [](const SelfCheck& c) { return c.name == "view" || c.name == "exposure"; }),
            2);
  EXPECT_EQ(machine.lasers(), 0);
}

TEST(ScanQueue, AnAbsentMachineIsWaitedForAndSaidSo) {
  FakeMachine machine;
  machine.link_down = true;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start()) << "the daemon runs without a machine";
  EXPECT_FALSE(bench.queue->machine().connected);
  EXPECT_NE(bench.queue->machine().error.find("cable cut"), std::string::npos);
  const auto refused = bench.queue->submit(quick_request(), "api");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().status, 503);
  EXPECT_NE(refused.error().detail.find("cable cut"), std::string::npos);
  machine.link_down = false;
  while (!bench.queue->machine().connected) std::this_thread::yield();
  EXPECT_TRUE(bench.queue->machine().error.empty());
  EXPECT_TRUE(bench.queue->submit(quick_request(), "api"));
}

/// Nothing is found by looking again.
constexpr std::chrono::hours kNever{24};

TEST(ScanQueue, TheNewsOfADeviceEndsTheWaitForTheMachine) {
  FakeMachine machine;
  machine.link_down = true;
  Bench bench(machine, machine.calibration(), kPollPeriod, kNever);
  ASSERT_TRUE(bench.queue->start());
  bench.queue->devices_changed();  // of another device
  machine.link_down = false;
  bench.queue->devices_changed();
  while (!bench.queue->machine().connected) std::this_thread::yield();
  EXPECT_TRUE(bench.queue->submit(quick_request(), "api"));
}

TEST(ScanQueue, ACameraUnpluggedWhileNothingRunsIsSaidAndTakenUpAgainWhenItIsBack) {
  FakeMachine machine;
  Bench bench(machine, machine.calibration(), kPollPeriod, kNever);
  ASSERT_TRUE(bench.queue->start());
  machine.camera_unplugged = true;
  while (bench.queue->machine().connected) std::this_thread::yield();
  EXPECT_NE(bench.queue->machine().error.find("camera"), std::string::npos) << bench.queue->machine().error;
  const auto refused = bench.queue->submit(quick_request(), "api");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().status, 503);
  machine.camera_unplugged = false;
  bench.queue->devices_changed();
  while (!bench.queue->machine().connected) std::this_thread::yield();
  ASSERT_TRUE(bench.queue->submit(quick_request(), "api"));
  EXPECT_EQ(bench.wait_for_end().state, ScanState::done);
}

TEST(ScanQueue, ALostMachineComesBackForTheNextScan) {
  FakeMachine machine;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  ASSERT_TRUE(bench.queue->submit(long_request(), "api"));
  bench.wait_for(ScanState::scanning, 3);
  machine.link_down = true;
  EXPECT_EQ(bench.wait_for_end().state, ScanState::failed);
  machine.link_down = false;
  while (!bench.queue->machine().connected) std::this_thread::yield();
  bench.forget();
  ASSERT_TRUE(bench.queue->submit(quick_request(), "api"));
  const ScanRecord record = bench.wait_for_end();
  EXPECT_EQ(record.state, ScanState::done) << record.reason;
  EXPECT_EQ(record.id, 2u);
}

TEST(ScanQueue, ACalibrationOfAnotherMachineIsRefusedWithBothNames) {
  FakeMachine machine;
  Calibration calibration = machine.calibration();
  calibration.machine = "Celadon other table 0002";
  Bench bench(machine, calibration);
  const auto started = bench.queue->start();
  ASSERT_FALSE(started);
  EXPECT_NE(started.error().message.find("Celadon other table 0002"), std::string::npos) << started.error().message;
  EXPECT_NE(started.error().message.find("Celadon test table 0001"), std::string::npos) << started.error().message;
}

TEST(ScanQueue, StoppingCancelsAndTheNextDaemonKnowsEveryScan) {
  FakeMachine machine;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  ASSERT_TRUE(bench.queue->submit(long_request(), "api"));
  ASSERT_TRUE(bench.queue->submit(quick_request(), "api"));
  bench.wait_for(ScanState::scanning, 3);
  bench.queue->stop();
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(machine.speed(), 0);
  bench.queue.reset();
  bench.open();
  const auto scans = bench.queue->scans();
  ASSERT_EQ(scans.size(), 2u);
  EXPECT_EQ(scans[0].state, ScanState::cancelled);
  EXPECT_EQ(scans[1].state, ScanState::cancelled);
  EXPECT_EQ(scans[0].request.name, "test vase");
  ASSERT_TRUE(bench.queue->start());
  const auto next = bench.queue->submit(quick_request(), "api");
  ASSERT_TRUE(next);
  EXPECT_EQ(next->id, 3u);
}

TEST(ScanQueue, APressThatUnlocksTheMachineDoesNotScan) {
  FakeMachine machine;
  Bench bench(machine);
  ASSERT_TRUE(bench.queue->start());
  ASSERT_TRUE(bench.queue->submit(long_request(), "api"));
  bench.wait_for(ScanState::scanning, 3);
  machine.with_plant([](auto& p) { p.emergency_stop = true; });
  EXPECT_EQ(bench.wait_for_end().state, ScanState::failed);
  machine.with_plant([](auto& p) { p.emergency_stop = false; });
  bench.forget();
  machine.press_button();  // unlocks
  machine.press_button();  // scans
  const ScanRecord record = bench.wait_for_end();
  EXPECT_EQ(record.id, 2u) << "one scan, of the second press";
  EXPECT_EQ(record.state, ScanState::done) << record.reason;
}

}  // namespace
}  // namespace celadon
