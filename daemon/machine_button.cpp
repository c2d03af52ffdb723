// What presses of the button ask the owner of the machine for. A press belongs to what the machine did when it began:
// to an idle machine it gives an order once its length is known, a scan is stopped by it at once, and what a
// calibration asked for is done.
#include <spdlog/spdlog.h>

#include "daemon/calibration/unmeasured.h"
#include "daemon/scan_queue.h"
#include "daemon/self_test.h"

namespace celadon {
namespace {

constexpr std::int64_t kMs_ns = 1'000'000;
constexpr std::int64_t kGlance_ns = 10 * kMs_ns;

}  // namespace

/// A self-test has no states and no progress.
class ScanQueue::TestObserver final : public ScanObserver {
 public:
  explicit TestObserver(ScanQueue& queue) : queue_(queue) {}
  void on_state(ScanState) override {}
  void on_progress(const ScanProgress&) override {}
  void on_status(const DeviceStatus& status) override { queue_.note_status(status); }
  std::optional<std::string> cancelled() override {
    if (queue_.host_button_begun()) return "by the button";
    return queue_.stopping() ? std::optional<std::string>("because the daemon ends") : std::nullopt;
  }

 private:
  ScanQueue& queue_;
};

void ScanQueue::look_at_host_button() {
  if (!host_button_) return;
  const auto news = host_button_->look(MonotonicClock().now_ns());
  if (!news) return;
  spdlog::warn("{}", *news);
  const MutexLock lock(mutex_);
  machine_.button = host_button_->problem();
}

bool ScanQueue::host_button_begun() {
  look_at_host_button();
  return host_button_ && host_button_->presses().use_begun();
}

/// Whoever pressed while a scan was solved or written saw a busy machine; a start would surprise.
void ScanQueue::drop_late_presses() {
  bool pressed = host_button_begun();
  if (connection_ && connection_->device) {
    if (const auto status = connection_->device->poll()) {
      note_status(*status);
    } else {
      spdlog::warn("{}", status.error().message());
    }
    pressed = connection_->device->take_button_presses() > 0 || pressed;
  }
  if (pressed) spdlog::info("the button was pressed too late to stop what ran; press again for another scan");
}

/// Waits on the machine's clock until a press of its own button is over, or long. Presses close after it are part of
/// the same order. nullopt: the machine is lost, or the daemon ends.
std::optional<PressLength> ScanQueue::follow_press(DeviceStatus status) {
  const auto is_long = [&] { return status.button_held_ms * kMs_ns >= options_.button.timing.lasting_ns; };
  while (status.button_down && !is_long()) {
    if (stopping()) return std::nullopt;
    connection_->clock->sleep_until(connection_->clock->now_ns() + kGlance_ns);
    auto polled = connection_->device->poll();
    if (!polled) {
      const auto kind = polled.error().kind;
      if (kind != DeviceError::Kind::fault && kind != DeviceError::Kind::interlock) {
        lose_connection(polled.error().message());
      } else {
        spdlog::warn("{}", polled.error().message());
      }
      return std::nullopt;
    }
    note_status(*polled);
    status = *polled;
  }
  connection_->device->take_button_presses();
  return is_long() ? PressLength::lasting : PressLength::brief;
}

void ScanQueue::obey(PressLength press) {
  const bool lasting = press == PressLength::lasting;
  spdlog::info("button pressed{}", lasting ? " for long" : "");
  switch (lasting ? options_.button.lasting : options_.button.brief) {
    case PressMeaning::nothing:
      return;
    case PressMeaning::self_test:
      return test_machine();
    case PressMeaning::scan:
      if (auto submitted = submit(options_.button_request, "button"); !submitted)
        spdlog::warn("the button's scan was not taken: {}", submitted.error().detail);
  }
}

void ScanQueue::test_machine() {
  if (!connection_->device) {
    spdlog::warn("there is no machine to test: the camera is a recording");
    return;
  }
  show_lamp(LampPattern::busy);
  if (host_button_) host_button_->presses().mark();
  TestObserver observer(*this);
  const std::optional<Calibration> present = present_calibration();
  const Calibration calibration = present ? *present : nothing_known(*connection_);
  auto found = self_test(equipment_of(*connection_, calibration), observer);
  if (!found && found.error().camera_was_gone && connect_again())
    found = self_test(equipment_of(*connection_, calibration), observer);
  const bool lost = !found && (found.error().device_lost || found.error().camera_lost);
  if (!lost) drop_late_presses();
  SelfTestResult result{found.has_value(), found ? *found : found.error().reason};
  if (!found && found.error().state == ScanState::cancelled)
    result.text = "It was stopped by the button or the daemon's end; hold the button for long to begin again.";
  spdlog::log(result.passed ? spdlog::level::info : spdlog::level::warn, "self-test {}: {}",
              result.passed ? "passed" : "failed", result.text);
  {
    const MutexLock lock(mutex_);
    machine_.self_test = result;
  }
  result_lamp_ = result.passed ? LampPattern::done : LampPattern::attention;
  result_lamp_end_ = std::chrono::steady_clock::now() + options_.result_lamp;
  if (lost) {
    lose_connection(result.text);
  } else {
    show_lamp(*result_lamp_);
  }
}

}  // namespace celadon
