// Calibrations in the queue: on a machine in closed form, whose camera sees no board, and with a calibration that
// follows a script in the place of the real one where its end is what matters.

#include <gtest/gtest.h>

#include <atomic>
#include <condition_variable>
#include <filesystem>
#include <mutex>
#include <thread>

#include <nlohmann/json.hpp>

#include "daemon/calibration/calibration_job.h"
#include "daemon/frame_feed.h"
#include "daemon/scan_queue.h"
#include "daemon/utc_time.h"
#include "tests/daemon/fake_machine.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

namespace fs = std::filesystem;
using testing::FakeMachine;
using testing::read_file;
using testing::TemporaryFolder;

ScanRequest short_scan() {
  ScanRequest request;
  request.profiles = 120;
  request.formats = {"surface.json"};
  return request;
}

/// Asks for two things by hand, takes views, solves, and leaves what the test wants.
class Script {
 public:
  explicit Script(const FakeMachine& machine) : calibration(machine.calibration()) { calibration.date = utc_now(); }

  RunCalibration run() {
    return [this](ScannerConnection&, const CalibrationRequest&, bool from_afar, CalibrationGuide& guide) {
      EXPECT_TRUE(from_afar);
      return follow(guide);
    };
  }

  Calibration calibration;
  bool refused = false;
  /// It goes no further than this state until somebody ends it.
  std::atomic<ScanState> stays_in = ScanState::idle;

 private:
  using Outcome = tl::expected<CalibrationOutcome, ScanStop>;

  Outcome follow(CalibrationGuide& guide) const {
    const auto go_through = [&](ScanState state) -> std::optional<ScanStop> {
      guide.on_state(state);
      do {
        if (const auto whom = guide.cancelled()) return cancelled_by(*whom);
        std::this_thread::yield();
      } while (stays_in == state);
      return std::nullopt;
    };
    if (const auto stop = go_through(ScanState::preparing)) return tl::make_unexpected(*stop);
    for (const char* instruction : {"Stand the board on the platter.", "Take everything off the platter."}) {
      guide.ask(instruction);
      while (!guide.done()) {
        if (const auto whom = guide.cancelled()) return tl::make_unexpected(cancelled_by(*whom));
        std::this_thread::yield();
      }
      EXPECT_TRUE(guide.done_from_afar());
      if (const auto stop = go_through(ScanState::scanning)) return tl::make_unexpected(*stop);
    }
    if (const auto stop = go_through(ScanState::solving)) return tl::make_unexpected(*stop);
    CalibrationOutcome outcome;
    outcome.verdict = refused ? "refused" : "good";
    outcome.steps = {{"camera", "good", "It is known.", ""}, {"axis", outcome.verdict, "It is seen.", "Turn it."}};
    outcome.values.systematic_mm = 0.0125;
    if (!refused) outcome.calibration = calibration;
    return outcome;
  }
};

/// A queue on a fake machine, and what it told of.
class CalibrationBench {
 public:
  CalibrationBench(FakeMachine& machine, RunCalibration run, std::optional<Calibration> calibration,
                   std::chrono::nanoseconds longest_wait = std::chrono::hours(1))
      : machine_(machine), run_(std::move(run)), calibration_(std::move(calibration)), longest_wait_(longest_wait) {
    if (calibration_) testing::write_file(file(), "the one before");
    open();
  }
  ~CalibrationBench() { queue.reset(); }

  void open() {
    auto store = ScanStore::open(folder / "store");
    if (!store) throw std::runtime_error(store.error().message);
    ScanQueueOptions options;
    options.button_request = short_scan();
    options.poll_period = std::chrono::milliseconds(1);
    options.first_retry = options.longest_retry = std::chrono::milliseconds(1);
    options.run_calibration = run_;
    options.calibration_file = file();
    options.longest_wait = longest_wait_;
    queue = std::make_unique<ScanQueue>(std::move(*store), calibration_, options,
                                        [this](const auto&) { return machine_.connect(machine_.calibration()); });
    queue->subscribe([this](std::uint64_t) {
      const std::lock_guard lock(mutex_);
      changed_.notify_all();
    });
    if (!queue->start()) throw std::runtime_error("no machine");
  }

  fs::path file() const { return folder / "scanner.toml"; }
  std::uint64_t begin() {
    const auto record = queue->calibrate({}, "api");
    EXPECT_TRUE(record) << record.error().detail;
    return record->id;
  }
  /// Waits for a state, or for the end.
  CalibrationRecord wait_for(std::uint64_t id, ScanState state, int step = 0) {
    CalibrationRecord record;
    wait([&] {
      record = *queue->calibration(id);
      return (record.state == state && record.step >= step) || is_final(record.state);
    });
    EXPECT_EQ(record.state, state) << record.reason;
    return record;
  }
  CalibrationRecord finish(std::uint64_t id) {
    for (const int step : {1, 2}) {
      wait_for(id, ScanState::paused, step);
      EXPECT_TRUE(queue->confirm(id, step));
    }
    CalibrationRecord record;
    wait([&] {
      record = *queue->calibration(id);
      return is_final(record.state);
    });
    return record;
  }
  ScanRecord wait_for_scan(std::uint64_t id) {
    wait([&] { return is_final(queue->scan(id)->state); });
    return *queue->scan(id);
  }
  template <class Condition>
  void wait(Condition condition) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, condition);
  }
  std::size_t files_beside() const {
    std::size_t count = 0;
    for (const auto& entry : fs::directory_iterator(folder.path())) count += entry.is_regular_file() ? 1 : 0;
    return count;
  }

  TemporaryFolder folder;
  std::unique_ptr<ScanQueue> queue;

 private:
  FakeMachine& machine_;
  const RunCalibration run_;
  const std::optional<Calibration> calibration_;
  const std::chrono::nanoseconds longest_wait_;
  std::mutex mutex_;
  std::condition_variable changed_;
};

Calibration old_calibration(const FakeMachine& machine) {
  Calibration calibration = machine.calibration();
  calibration.date = "2020-02-03T04:05:06Z";
  return calibration;
}

void expect_safe(FakeMachine& machine) {
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(machine.speed(), 0);
}

TEST(CalibrationQueue, WithoutACalibrationNothingIsScannedUntilOnePassed) {
  FakeMachine machine;
  Script script(machine);
  CalibrationBench bench(machine, script.run(), std::nullopt);
  EXPECT_EQ(bench.queue->machine().calibrated, "");
  ASSERT_EQ(bench.queue->machine().calibration_due.size(), 1u);
  const auto refused = bench.queue->submit(short_scan(), "api");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().status, 409);
  EXPECT_NE(refused.error().detail.find("calibrate first: "), std::string::npos) << refused.error().detail;
  machine.press_button();  // asks for a scan, too, and nothing more

  const CalibrationRecord record = bench.finish(bench.begin());
  ASSERT_EQ(record.state, ScanState::done) << record.reason;
  EXPECT_EQ(record.verdict, "good");
  EXPECT_EQ(record.steps.size(), 2u);
  EXPECT_EQ(record.files, std::vector<std::string>{"calibration.toml"});
  EXPECT_EQ(read_file(bench.file()), format_calibration(script.calibration));
  EXPECT_EQ(read_file(record.folder / "calibration.toml"), format_calibration(script.calibration));
  EXPECT_EQ(bench.files_beside(), 1u) << "there was none before";
  EXPECT_EQ(bench.queue->machine().calibrated, script.calibration.date);
  EXPECT_TRUE(bench.queue->machine().calibration_due.empty());
  EXPECT_TRUE(bench.queue->scans().empty());

  const auto scan = bench.queue->submit(short_scan(), "api");
  ASSERT_TRUE(scan) << scan.error().detail;
  EXPECT_EQ(bench.wait_for_scan(scan->id).state, ScanState::done) << bench.queue->scan(scan->id)->reason;
}

TEST(CalibrationQueue, TheNextScanUsesTheNewOneAndTheOldOneIsKeptWithItsDate) {
  FakeMachine machine;
  Script script(machine);
  CalibrationBench bench(machine, script.run(), old_calibration(machine));
  EXPECT_EQ(bench.finish(bench.begin()).state, ScanState::done);
  EXPECT_EQ(read_file(bench.file()), format_calibration(script.calibration));
  EXPECT_EQ(read_file(bench.folder / "scanner-2020-02-03T04-05-06Z.toml"), "the one before");
  const auto scan = bench.queue->submit(short_scan(), "api");
  ASSERT_TRUE(scan);
  const ScanRecord record = bench.wait_for_scan(scan->id);
  ASSERT_EQ(record.state, ScanState::done) << record.reason;
  EXPECT_EQ(read_file(record.folder / "report.json").find("The calibration of 2020"), std::string::npos);
}

TEST(CalibrationQueue, ARefusedOneChangesNothing) {
  FakeMachine machine;
  Script script(machine);
  script.refused = true;
  CalibrationBench bench(machine, script.run(), old_calibration(machine));
  const CalibrationRecord record = bench.finish(bench.begin());
  EXPECT_EQ(record.state, ScanState::failed);
  EXPECT_EQ(record.failure, ScanFailure::data);
  EXPECT_EQ(record.verdict, "refused");
  EXPECT_NE(record.reason.find("axis"), std::string::npos) << record.reason;
  EXPECT_TRUE(record.files.empty());
  EXPECT_EQ(read_file(bench.file()), "the one before");
  EXPECT_EQ(bench.files_beside(), 1u);
  EXPECT_EQ(bench.queue->machine().calibrated, "2020-02-03T04:05:06Z");
}

TEST(CalibrationQueue, OneThatCannotBeWrittenIsNotUsed) {
  FakeMachine machine;
  Script script(machine);
  CalibrationBench bench(machine, script.run(), old_calibration(machine));
  fs::remove(bench.file());
  fs::create_directory(bench.file());
  const CalibrationRecord record = bench.finish(bench.begin());
  EXPECT_EQ(record.state, ScanState::failed);
  EXPECT_EQ(record.failure, ScanFailure::system);
  EXPECT_NE(record.reason.find(bench.file().string()), std::string::npos) << record.reason;
  EXPECT_EQ(bench.queue->machine().calibrated, "2020-02-03T04:05:06Z");
}

TEST(CalibrationQueue, OneConfirmIsOneStep) {
  FakeMachine machine;
  Script script(machine);
  script.stays_in = ScanState::scanning;
  CalibrationBench bench(machine, script.run(), std::nullopt);
  const std::uint64_t id = bench.begin();
  EXPECT_NE(bench.wait_for(id, ScanState::paused).instruction, "");
  const auto beforehand = bench.queue->confirm(id, 2);
  ASSERT_FALSE(beforehand);
  EXPECT_EQ(beforehand.error().status, 409);
  EXPECT_NE(beforehand.error().detail.find("asks for step 1, not 2"), std::string::npos) << beforehand.error().detail;
  EXPECT_EQ(bench.queue->calibration(id)->state, ScanState::paused);
  ASSERT_TRUE(bench.queue->confirm(id, std::nullopt));
  const auto twice = bench.queue->confirm(id, std::nullopt);
  ASSERT_FALSE(twice);
  EXPECT_EQ(twice.error().status, 409);
  bench.wait_for(id, ScanState::scanning);
  EXPECT_EQ(bench.queue->confirm(id, std::nullopt).error().status, 409);
  script.stays_in = ScanState::idle;
  EXPECT_EQ(bench.wait_for(id, ScanState::paused, 2).step, 2);
  EXPECT_EQ(bench.queue->confirm(id, 1).error().status, 409) << "late, and of the step before";
  EXPECT_EQ(bench.queue->calibration(id)->state, ScanState::paused);
  EXPECT_EQ(bench.queue->confirm(99, std::nullopt).error().status, 404);
}

TEST(CalibrationQueue, OtherJobsWaitForIt) {
  FakeMachine machine;
  Script script(machine);
  CalibrationBench bench(machine, script.run(), old_calibration(machine));
  const std::uint64_t first = bench.begin();
  bench.wait_for(first, ScanState::paused);
  EXPECT_EQ(bench.queue->machine().current_calibration, first);
  EXPECT_EQ(bench.queue->machine().state, ScanState::paused);
  const std::uint64_t second = bench.begin();
  const auto scan = bench.queue->submit(short_scan(), "api");
  ASSERT_TRUE(scan);
  EXPECT_EQ(scan->id, 3u) << "one series of numbers";
  EXPECT_EQ(bench.queue->calibration(second)->state, ScanState::queued);
  EXPECT_EQ(bench.queue->scan(scan->id)->state, ScanState::queued);
  EXPECT_EQ(bench.queue->confirm(second, std::nullopt).error().status, 409);
  ASSERT_TRUE(bench.queue->cancel(second));
  EXPECT_EQ(bench.queue->calibration(second)->state, ScanState::cancelled);
  EXPECT_EQ(bench.finish(first).state, ScanState::done);
  EXPECT_EQ(bench.wait_for_scan(scan->id).state, ScanState::done);
  EXPECT_EQ(bench.queue->machine().current_calibration, 0u);
}

TEST(CalibrationQueue, CancelEndsItInEachState) {
  for (const ScanState state : {ScanState::preparing, ScanState::paused, ScanState::scanning, ScanState::solving}) {
    SCOPED_TRACE(to_string(state));
    FakeMachine machine;
    Script script(machine);
    script.stays_in = state;
    CalibrationBench bench(machine, script.run(), std::nullopt);
    const std::uint64_t id = bench.begin();
    if (state == ScanState::scanning || state == ScanState::solving) {
      bench.wait_for(id, ScanState::paused);
      ASSERT_TRUE(bench.queue->confirm(id, 1));
    }
    if (state == ScanState::solving) {
      bench.wait_for(id, ScanState::paused, 2);
      ASSERT_TRUE(bench.queue->confirm(id, 2));
    }
    bench.wait_for(id, state);
    ASSERT_TRUE(bench.queue->cancel(id));
    EXPECT_NE(bench.wait_for(id, ScanState::cancelled).reason.find("on request"), std::string::npos);
    EXPECT_FALSE(fs::exists(bench.file()));
    EXPECT_EQ(bench.queue->cancel(id).error().status, 409);
  }
}

TEST(CalibrationQueue, WithoutAHandItEnds) {
  FakeMachine machine;
  CalibrationBench bench(machine, run_calibration, std::nullopt, std::chrono::nanoseconds(0));
  const std::uint64_t id = bench.begin();
  bench.wait([&] { return is_final(bench.queue->calibration(id)->state); });
  const CalibrationRecord record = *bench.queue->calibration(id);
  EXPECT_EQ(record.state, ScanState::cancelled);
  EXPECT_NE(record.reason.find("no hand"), std::string::npos) << record.reason;
  EXPECT_EQ(record.step, 1);
  expect_safe(machine);
}

// Where the board should be held the machine takes pictures all the time.
TEST(CalibrationQueue, WithoutAHandAtTheBoardItEnds) {
  FakeMachine machine;
  const auto at_the_board = [](ScannerConnection& connection, const CalibrationRequest& request, bool from_afar,
                               CalibrationGuide& guide) {
    class Confirmed final : public CalibrationGuide {
     public:
      explicit Confirmed(CalibrationGuide& guide) : guide_(guide) {}
      void ask(const std::string&) override {}
      bool done() override { return true; }
      void on_look(const BoardLook& look) override { guide_.on_look(look); }
      void on_turn(int, int, int, bool) override {}
      void on_passes(int, int) override {}
      void on_stop(int, const AxisStop&, bool) override {}
      std::optional<std::string> cancelled() override { return guide_.cancelled(); }

     private:
      CalibrationGuide& guide_;
    } confirmed(guide);
    return run_calibration(connection, request, from_afar, confirmed);
  };
  CalibrationBench bench(machine, at_the_board, std::nullopt, std::chrono::nanoseconds(0));
  const std::uint64_t id = bench.begin();
  bench.wait([&] { return is_final(bench.queue->calibration(id)->state); });
  const CalibrationRecord record = *bench.queue->calibration(id);
  EXPECT_NE(record.reason.find("no hand"), std::string::npos) << record.reason;
  EXPECT_EQ(record.message.find("no board: "), 0u) << record.message;
}

TEST(CalibrationQueue, APressConfirmsWhatWasAskedForAndStopsWhatMoves) {
  FakeMachine machine;
  CalibrationBench bench(machine, run_calibration, std::nullopt);
  const std::uint64_t id = bench.begin();
  const CalibrationRecord asked = bench.wait_for(id, ScanState::paused);
  EXPECT_EQ(asked.step, 1);
  EXPECT_NE(asked.instruction.find("Hold the board"), std::string::npos);
  bench.wait([&] { return machine.lamp() == LampPattern::attention; });
  machine.press_button();
  bench.wait([&] { return bench.queue->calibration(id)->look.has_value(); });
  const CalibrationRecord seen = *bench.queue->calibration(id);
  EXPECT_EQ(seen.state, ScanState::scanning);
  EXPECT_FALSE(seen.look->found);
  EXPECT_NE(seen.look->problem, "");
  EXPECT_EQ(seen.message.find("no board: "), 0u) << seen.message;
  machine.press_button();
  EXPECT_NE(bench.wait_for(id, ScanState::cancelled).reason.find("button"), std::string::npos);
  expect_safe(machine);
}

TEST(CalibrationQueue, AConfirmFromAfarIsFollowedByTheWarning) {
  FakeMachine machine;
  CalibrationBench bench(machine, run_calibration, std::nullopt);
  std::atomic<std::int64_t> warned_ns = 0, scanned_ns = 0;
  bench.queue->subscribe([&, q = bench.queue.get()](std::uint64_t changed) {
    const CalibrationRecord record = *q->calibration(changed);
    if (record.state == ScanState::paused) warned_ns = 0;  // of the start
    if (record.state == ScanState::preparing && machine.lamp() == LampPattern::warning) warned_ns = machine.now_ns();
    if (record.state == ScanState::scanning && scanned_ns == 0) scanned_ns = machine.now_ns();
  });
  const std::uint64_t id = bench.begin();
  bench.wait_for(id, ScanState::paused);
  ASSERT_TRUE(bench.queue->confirm(id, 1));
  bench.wait([&] { return scanned_ns != 0; });
  EXPECT_GT(warned_ns, 0);
  EXPECT_GE(scanned_ns - warned_ns, 2'000'000'000);
  ASSERT_TRUE(bench.queue->cancel(id));
  bench.wait_for(id, ScanState::cancelled);
  expect_safe(machine);
}

TEST(CalibrationQueue, ALostMachineEndsItAndWhatWaits) {
  FakeMachine machine;
  CalibrationBench bench(machine, run_calibration, old_calibration(machine));
  const std::uint64_t id = bench.begin(), waiting = bench.begin();
  bench.wait_for(id, ScanState::paused);
  machine.link_down = true;
  const CalibrationRecord record = bench.wait_for(id, ScanState::failed);
  EXPECT_EQ(record.failure, ScanFailure::device);
  EXPECT_NE(record.reason.find("cable cut"), std::string::npos) << record.reason;
  EXPECT_NE(bench.wait_for(waiting, ScanState::failed).reason.find("before it began"), std::string::npos);
}

TEST(CalibrationQueue, TheNextDaemonKnowsWhatBecameOfIt) {
  FakeMachine machine;
  Script script(machine);
  CalibrationBench bench(machine, script.run(), std::nullopt);
  const CalibrationRecord done = bench.finish(bench.begin());
  const std::uint64_t id = bench.begin();
  bench.wait_for(id, ScanState::paused);
  fs::copy(bench.folder / "store", bench.folder / "copy", fs::copy_options::recursive);  // as a killed one leaves it
  bench.queue->stop();
  EXPECT_EQ(bench.queue->calibration(id)->state, ScanState::cancelled);
  expect_safe(machine);

  auto store = ScanStore::open(bench.folder / "copy");
  ASSERT_TRUE(store) << store.error().message;
  std::vector<std::string> problems;
  const auto found = store->load_calibrations(problems);
  EXPECT_TRUE(problems.empty()) << problems.front();
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].state, ScanState::done);
  nlohmann::json before = to_json(done), after = to_json(found[0]);
  before.erase("folder");
  after.erase("folder");
  EXPECT_EQ(before, after);
  EXPECT_EQ(found[1].state, ScanState::interrupted);
  EXPECT_NE(found[1].reason.find("nothing was changed"), std::string::npos) << found[1].reason;
  EXPECT_TRUE(store->load(problems).empty());
  EXPECT_EQ(*store->new_scan(), id + 1);
}

}  // namespace
}  // namespace celadon
