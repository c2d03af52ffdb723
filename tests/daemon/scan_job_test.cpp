// One scan, cancelled at any instant at which it asks.

#include "daemon/scan_job.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>

#include <nlohmann/json.hpp>

#include "daemon/profile_log.h"
#include "tests/daemon/fake_machine.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::FakeMachine;
using testing::TemporaryFolder;

/// Says "stop" from the n-th time it is asked.
class CancelAt final : public ScanObserver {
 public:
  explicit CancelAt(int n) : left_(n) {}
  void on_state(ScanState state) override { state_ = state; }
  void on_progress(const ScanProgress& progress) override { progress_ = progress; }
  void on_status(const DeviceStatus&) override {}
  std::optional<std::string> cancelled() override {
    ++asked_;
    if (left_-- > 0) return std::nullopt;
    return "by the test";
  }
  int asked() const { return asked_; }
  ScanState state() const { return state_; }
  const ScanProgress& progress() const { return progress_; }

 private:
  int left_, asked_ = 0;
  ScanState state_ = ScanState::idle;
  ScanProgress progress_;
};

struct Outcome {
  tl::expected<ScanOutcome, ScanStop> scan;
  int asked;
  ScanProgress progress;
};

Outcome scan(FakeMachine& machine, const TemporaryFolder& folder, ScanMode mode, int cancel_at,
             const std::string& shape = "cylinder") {
  const Calibration calibration = machine.calibration();
  auto connection = machine.connect(calibration);
  EXPECT_TRUE(connection) << connection.error().message;
  ScanTask task;
  task.request.profiles = 16;
  task.request.mode = mode;
  task.request.shape = shape;
  task.request.formats = {"surface.json"};
  task.date = "2026-01-02T03:04:05Z";
  task.log_file = folder / "profiles.log";
  task.results_folder = folder / "results";
  CancelAt observer(cancel_at);
  auto outcome = run_scan({connection->device.get(), *connection->camera, *connection->clock, calibration, nullptr, {}},
                          task, observer);
  return {std::move(outcome), observer.asked(), observer.progress()};
}

RC_GTEST_PROP(ScanJob, CancelledAtAnyInstantItIsSafeAndKeepsItsLog, ()) {
  const auto mode = *rc::gen::element(ScanMode::step, ScanMode::sweep);
  FakeMachine machine;
  const TemporaryFolder folder;
  const int instant = *rc::gen::inRange(0, 250);
  const Outcome outcome = scan(machine, folder, mode, instant);
  RC_ASSERT(machine.lasers() == 0);
  RC_ASSERT(machine.speed() == 0.0);
  if (outcome.scan) {
    RC_ASSERT(outcome.asked <= instant);
    return;
  }
  RC_ASSERT(outcome.scan.error().state == ScanState::cancelled);
  RC_ASSERT(!std::filesystem::exists(folder / "results"));
  RC_ASSERT(!std::filesystem::exists(folder / "results.part"));
  if (!std::filesystem::exists(folder / "profiles.log")) return;
  auto log = ProfileLogReader::open(folder / "profiles.log");
  RC_ASSERT(log.has_value());
  while ((*log)->next() != nullptr) {
  }
  RC_ASSERT((*log)->error().empty());
  RC_ASSERT((*log)->torn_bytes() == 0u);
}

// Without a surface the log itself is the result, and the report says so.
TEST(ScanJob, SamplesAreAResult) {
  FakeMachine machine;
  const TemporaryFolder folder;
  const Outcome outcome = scan(machine, folder, ScanMode::step, 1'000'000, "none");
  ASSERT_TRUE(outcome.scan) << outcome.scan.error().reason;
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(outcome.scan->files, (std::vector<std::string>{"profiles.log", "report.json"}));
  EXPECT_EQ(testing::read_file(folder / "results" / "profiles.log"), testing::read_file(folder / "profiles.log"));
  auto log = ProfileLogReader::open(folder / "results" / "profiles.log");
  ASSERT_TRUE(log);
  std::size_t samples = 0;
  while (const Profile* profile = (*log)->next()) samples += profile->size();
  EXPECT_EQ((*log)->header().request.shape, "none");
  const auto report = nlohmann::json::parse(testing::read_file(folder / "results" / "report.json"));
  EXPECT_EQ(report["base"], "none");
  EXPECT_EQ(report["points"], samples);
  EXPECT_FALSE(report.contains("model"));
  EXPECT_NE(report["warnings"].dump().find("No surface was fitted"), std::string::npos);
  EXPECT_FALSE(outcome.progress.fit_rms_mm);
}

TEST(ScanJob, HomingIsCutShort) {
  FakeMachine machine;
  const TemporaryFolder folder;
  const Outcome outcome = scan(machine, folder, ScanMode::sweep, 3);
  ASSERT_FALSE(outcome.scan);
  EXPECT_NE(outcome.scan.error().reason.find("home"), std::string::npos) << outcome.scan.error().reason;
  EXPECT_EQ(machine.speed(), 0);
}

TEST(ScanJob, ProgressEndsAtTheWholeTurn) {
  FakeMachine machine;
  const TemporaryFolder folder;
  const Outcome outcome = scan(machine, folder, ScanMode::step, 1'000'000);
  ASSERT_TRUE(outcome.scan) << outcome.scan.error().reason;
  EXPECT_EQ(outcome.progress.fraction, 1);
  EXPECT_EQ(outcome.progress.frames, 20);
  EXPECT_GE(outcome.progress.angle_deg, 360);
  EXPECT_GT(outcome.progress.samples, 1000u);
}

// Of positions that carry the time of their exchange the scan says what that leaves open; 0.3 ms is what one takes
// here.
TEST(ScanJob, UnstampedPositionsAreTold) {
  for (const std::uint16_t features : {std::uint16_t{0}, protocol::kStampedByHost}) {
    FakeMachine machine(features);
    const TemporaryFolder here;
    const Outcome outcome = scan(machine, here, ScanMode::sweep, 1'000'000);
    ASSERT_TRUE(outcome.scan) << outcome.scan.error().reason;
    const auto& warnings = outcome.scan->warnings;
    const auto told = std::find_if(warnings.begin(), warnings.end(), [](const std::string& text) {
      return text.find("does not stamp its positions") != std::string::npos;
    });
    ASSERT_EQ(told != warnings.end(), features != 0);
    if (told == warnings.end()) continue;
    // 180 deg/s * 0.3 ms / sqrt(12)
    EXPECT_NE(told->find("up to 0.0156 deg"), std::string::npos) << *told;
  }
}

TEST(ScanJob, AnExistingLogOrResultIsNeverOverwritten) {
  FakeMachine machine;
  const TemporaryFolder folder;
  testing::write_file(folder / "profiles.log", "precious");
  const Outcome outcome = scan(machine, folder, ScanMode::sweep, 1'000'000);
  ASSERT_FALSE(outcome.scan);
  EXPECT_EQ(testing::read_file(folder / "profiles.log"), "precious");
  EXPECT_EQ(machine.lasers(), 0);
}

}  // namespace
}  // namespace celadon
