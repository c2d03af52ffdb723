// What presses ask for: of the machine's own button, through the real device, and of one at the computer.

#include <gtest/gtest.h>

#include <algorithm>
#include <condition_variable>
#include <mutex>

#include "daemon/scan_queue.h"
#include "tests/daemon/fake_machine.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::FakeMachine;
using testing::TemporaryFolder;

constexpr std::int64_t kMs = 1'000'000;

/// A button at the computer; its edges have the present's stamps, or those from some time ago.
class Contact {
 public:
  /// It went down that long ago, and up again after it was held.
  void press(std::int64_t ago_ms, std::int64_t held_ms) {
    const std::int64_t from_ns = MonotonicClock().now_ns() - ago_ms * kMs;
    const std::lock_guard lock(mutex_);
    edges_.push_back({true, from_ns});
    edges_.push_back({false, from_ns + held_ms * kMs});
  }
  HostButton::Open opener() {
    return [this] { return std::make_unique<Source>(*this); };
  }

 private:
  class Source final : public ButtonSource {
   public:
    explicit Source(Contact& contact) : contact_(contact) {}
    bool down_at_open() const override { return false; }
    tl::expected<void, ButtonError> read(std::vector<ButtonEdge>& edges) override {
      const std::lock_guard lock(contact_.mutex_);
      edges.insert(edges.end(), contact_.edges_.begin(), contact_.edges_.end());
      contact_.edges_.clear();
      return {};
    }

   private:
    Contact& contact_;
  };
  std::mutex mutex_;
  std::vector<ButtonEdge> edges_;
};

class Bench {
 public:
  explicit Bench(FakeMachine& machine, const ButtonOptions& button = {}) {
    auto store = ScanStore::open(folder / "store");
    if (!store) throw std::runtime_error(store.error().message);
    ScanQueueOptions options;
    options.button_request = request();
    options.button = button;
    options.poll_period = std::chrono::milliseconds(1);
    options.first_retry = options.longest_retry = std::chrono::milliseconds(1);
    const Calibration calibration = machine.calibration();
    queue = std::make_unique<ScanQueue>(std::move(*store), calibration, options,
                                        [&machine, calibration](const auto&) { return machine.connect(calibration); });
    queue->subscribe([this, q = queue.get()](std::uint64_t id) {
      const ScanRecord record = *q->scan(id);
      if (at_state && record.state == ScanState::exporting) std::exchange(at_state, nullptr)();
      const std::lock_guard lock(mutex_);
      last_ = record;
      changed_.notify_all();
    });
    if (!queue->start()) throw std::runtime_error("no machine");
  }
  ~Bench() { queue.reset(); }

  static ScanRequest request() {
    ScanRequest request;
    request.profiles = 120;
    request.formats = {"surface.json"};
    return request;
  }
  template <class Condition>
  ScanRecord wait_for(Condition condition) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return condition(last_); });
    return last_;
  }
  ScanRecord wait_for_end(std::uint64_t id) {
    return wait_for([id](const ScanRecord& r) { return r.id == id && is_final(r.state); });
  }
  void wait_for_frames(std::uint64_t id) {
    wait_for([id](const ScanRecord& r) { return r.id == id && (r.progress.frames >= 3 || is_final(r.state)); });
  }
  SelfTestResult wait_for_self_test() {
    for (;;) {
      if (const auto result = queue->machine().self_test) return *result;
      std::this_thread::yield();
    }
  }

  TemporaryFolder folder;
  std::function<void()> at_state;  ///< called once, when a scan's files are about to be written
  std::unique_ptr<ScanQueue> queue;

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  ScanRecord last_;
};

void hold(FakeMachine& machine, bool down) {
  machine.with_plant([down](test::TestPlant& p) { p.button = down; });
}

TEST(Button, ALongPressTestsTheMachineAndScansNothing) {
  FakeMachine machine;
  Bench bench(machine);
  hold(machine, true);
  const SelfTestResult result = bench.wait_for_self_test();
  EXPECT_TRUE(result.passed) << result.text;
  EXPECT_NE(result.text.find("the index was found"), std::string::npos) << result.text;
  hold(machine, false);
  int homes = 0, moves = 0;
  machine.with_plant([&](test::TestPlant& p) { homes = p.homes, moves = p.moves; });
  EXPECT_GE(homes, 1);
  EXPECT_EQ(moves, 0);
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(machine.speed(), 0);
  EXPECT_TRUE(bench.queue->scans().empty());
  // The release means nothing any more.
  const auto scan = bench.queue->submit(Bench::request(), "api");
  ASSERT_TRUE(scan);
  EXPECT_EQ(bench.wait_for_end(scan->id).state, ScanState::done);
  EXPECT_EQ(bench.queue->scans().size(), 1u);
}

TEST(Button, ASelfTestThatFailsSaysWhy) {
  struct Case {
    std::function<void(FakeMachine&)> harm;
    const char* says;
  };
  for (const Case& c : {Case{[](FakeMachine& m) { m.laser_hidden = true; }, "although it is switched off"},
                        Case{[](FakeMachine& m) { m.with_plant([](auto& p) { p.index_exists = false; }); }, "index"},
                        Case{[](FakeMachine& m) { m.camera_silent = true; }, "no frame"}}) {
    FakeMachine machine;
    c.harm(machine);
    Bench bench(machine);
    hold(machine, true);
    const SelfTestResult result = bench.wait_for_self_test();
    EXPECT_FALSE(result.passed);
    EXPECT_NE(result.text.find(c.says), std::string::npos) << result.text;
    EXPECT_EQ(machine.lasers(), 0);
    EXPECT_EQ(machine.speed(), 0);
    bench.queue->stop();
  }
}

TEST(Button, APressWhileFilesAreWrittenStartsNothing) {
  FakeMachine machine;
  Bench bench(machine);
  bench.at_state = [&] { machine.press_button(); };
  ASSERT_TRUE(bench.queue->submit(Bench::request(), "api"));
  EXPECT_EQ(bench.wait_for_end(1).state, ScanState::done);
  ASSERT_TRUE(bench.queue->submit(Bench::request(), "api"));
  EXPECT_EQ(bench.wait_for_end(2).state, ScanState::done);
  EXPECT_EQ(bench.queue->scans().size(), 2u);
}

TEST(Button, TheMeaningsAreThoseOfTheConfiguration) {
  FakeMachine machine;
  ButtonOptions button;
  button.brief = PressMeaning::nothing;
  button.lasting = PressMeaning::scan;
  Bench bench(machine, button);
  machine.press_button();
  ASSERT_TRUE(bench.queue->submit(Bench::request(), "api"));
  EXPECT_EQ(bench.wait_for_end(1).requested_by, "api");
  EXPECT_EQ(bench.queue->scans().size(), 1u);
  hold(machine, true);
  bench.wait_for_frames(2);
  hold(machine, false);
  EXPECT_EQ(bench.wait_for_end(2).requested_by, "button");
}

TEST(Button, OneAtTheComputerStartsStopsAndTests) {
  FakeMachine machine;
  Contact contact;
  ButtonOptions button;
  button.open = contact.opener();
  Bench bench(machine, button);
  contact.press(500, 100);
  bench.wait_for_frames(1);
  contact.press(500, 100);
  const ScanRecord stopped = bench.wait_for_end(1);
  EXPECT_EQ(stopped.requested_by, "button");
  EXPECT_EQ(stopped.state, ScanState::cancelled);
  EXPECT_NE(stopped.reason.find("by the button"), std::string::npos) << stopped.reason;
  EXPECT_EQ(machine.lasers(), 0);
  EXPECT_EQ(machine.speed(), 0);
  contact.press(5'000, 3'000);
  const SelfTestResult result = bench.wait_for_self_test();
  EXPECT_TRUE(result.passed) << result.text;
  EXPECT_EQ(bench.queue->scans().size(), 1u);
}

}  // namespace
}  // namespace celadon
