// The thread of the queue that owns machine and camera: connects, watches, scans, makes safe. What clients see of it is
// in scan_queue.cpp, how it calibrates in machine_calibration.cpp.
#include <algorithm>
#include <cmath>
#include <ctime>
#include <numbers>

#include <spdlog/spdlog.h>

#include "daemon/calibration_due.h"
#include "daemon/scan_lasers.h"
#include "daemon/scan_queue.h"
#include "daemon/scan_stops.h"

namespace celadon {
namespace {

const char* motion_text(MotionState state) {
  return protocol::find_code(protocol::kMotionStates, static_cast<std::uint16_t>(state)).name;
}

LampPattern lamp_of(ScanState state) {
  switch (state) {
    case ScanState::preparing:
      return LampPattern::warning;  // the laser is about to shine and the table to turn
    case ScanState::scanning:
    case ScanState::solving:
    case ScanState::exporting:
      return LampPattern::busy;
    case ScanState::done:
      return LampPattern::done;
    case ScanState::paused:  // a hand is asked for
    case ScanState::failed:
    case ScanState::cancelled:
    case ScanState::interrupted:
      return LampPattern::attention;
    case ScanState::idle:
    case ScanState::queued:
      break;
  }
  return LampPattern::ready;
}

}  // namespace

/// What a running scan tells, into the records.
class ScanQueue::Observer final : public ScanObserver {
 public:
  Observer(ScanQueue& queue, std::uint64_t id) : queue_(queue), id_(id) {}

  void on_state(ScanState state) override { queue_.show_state(id_, state); }
  void on_progress(const ScanProgress& progress) override {
    queue_.change(id_, false, [&](ScanRecord& record) { record.progress = progress; });
  }
  void on_status(const DeviceStatus& status) override { queue_.note_status(status); }
  std::optional<std::string> cancelled() override {
    if (queue_.host_button_begun()) return "by the button";
    const MutexLock lock(queue_.mutex_);
    if (queue_.stop_) return "because the daemon ends";
    return queue_.cancel_;
  }

 private:
  ScanQueue& queue_;
  const std::uint64_t id_;
};

void ScanQueue::own_machine() {
  while (!stopping()) {
    if (!connection_) {
      connect();
      continue;
    }
    const bool jobs_wait = !nothing_waits();
    // Also before a job: presses up to here are those of an idle machine, not the ones that end a job.
    watch_machine();
    if (!connection_) continue;
    if (!jobs_wait) {
      rest();
      continue;
    }
    std::optional<std::uint64_t> next;
    {
      const MutexLock lock(mutex_);
      if (!queue_.empty()) {
        next = queue_.front();
        queue_.pop_front();
        cancel_.reset();
        (calibrations_.contains(*next) ? machine_.current_calibration : machine_.current_scan) = *next;
      }
    }
    if (next) run(*next);
  }
  std::deque<std::uint64_t> left;
  {
    const MutexLock lock(mutex_);
    left.swap(queue_);
  }
  for (const std::uint64_t id : left) {
    change_job(id, [](JobRecord& record) {
      record.state = ScanState::cancelled;
      record.reason = "The daemon ended before it began; start it again.";
    });
  }
  if (connection_) {
    show_lamp(LampPattern::off);
    if (connection_->device) spdlog::info("machine made safe: {}", connection_->device->make_safe().text);
    connection_.reset();
  }
}

void ScanQueue::connect() {
  look_at_host_button();
  {
    const MutexLock lock(mutex_);
    devices_changed_ = false;
  }
  const std::optional<Calibration> calibration = present_calibration();
  auto connection = connect_(calibration);
  if (connection) {
    connection_ = std::move(*connection);
    const std::string machine = connection_->device ? connection_->device->identity().machine : calibration->machine;
    const bool simulated = is_simulated(*connection_);
    if (connection_->device) {
      spdlog::info("connected to {} at {}, camera {} at {}{}", machine, options_.device_url,
                   connection_->camera->mode().identity, options_.camera_url, simulated ? " (simulated)" : "");
      if (const auto& found = connection_->device->found_at_open().text; !found.empty()) spdlog::info("{}", found);
      connection_->device->take_button_presses();
    } else {
      spdlog::info("recording of {} at {}{}", connection_->camera->mode().identity, options_.camera_url,
                   simulated ? " (simulated)" : "");
    }
    retry_ = options_.first_retry;
    lamp_ = LampPattern::off;
    result_lamp_.reset();
    was_locked_ = false;
    const MutexLock lock(mutex_);
    machine_.connected = true;
    machine_.machine = machine;
    machine_.simulated = simulated;
    machine_.lasers =
        lasers_present(connection_->device.get(), *connection_->camera, calibration.value_or(Calibration{}));
    machine_.travels = travels_of(connection_->device.get());
    machine_.error.clear();
    machine_.found = connection_->device ? connection_->device->found_at_open().text : "";
    first_attempt_done_ = true;
    wake_.notify_all();
    return;
  }
  if (host_button_ && host_button_->presses().take()) spdlog::warn("button pressed, but no machine is connected");
  bool known = false;
  {
    const MutexLock lock(mutex_);
    known = machine_.error == connection.error().message;
    machine_.connected = false;
    machine_.error = connection.error().message;
    if (!first_attempt_done_ && connection.error().wrong_configuration) refused_ = connection.error();
    first_attempt_done_ = true;
    wake_.notify_all();
  }
  // Each cause once: an absent machine would fill the log.
  if (!known) spdlog::error("no machine: {}", connection.error().message);
  const MutexLock lock(mutex_);
  if (!stop_ && !devices_changed_) wake_.wait_for(mutex_, retry_);
  // A device may be there a moment before it can be opened.
  retry_ = devices_changed_ ? options_.first_retry : std::min(2 * retry_, options_.longest_retry);
}

/// One look at the machine while no scan runs: heartbeat, state for the clients, the button.
void ScanQueue::watch_machine() {
  look_at_host_button();
  if (!connection_->device) {
    if (host_button_) {
      if (const auto press = host_button_->presses().take()) obey(*press);
    }
    return;
  }
  auto status = connection_->device->poll();
  if (!status) {
    const auto kind = status.error().kind;
    if (kind == DeviceError::Kind::fault || kind == DeviceError::Kind::interlock) {
      spdlog::warn("{}", status.error().message());
      return;
    }
    lose_connection(status.error().message());
    return;
  }
  // Held open, a camera that is gone would keep the name of its node from the one that is plugged in again.
  if (const auto present = connection_->camera->check_present(); !present) {
    if (!connect_again()) lose_connection(present.error().message);
    return;
  }
  const bool unlocked_now = was_locked_ && !status->local_action_needed;
  note_status(*status);
  // A press that unlocks the machine after a stop means "go on", not "scan".
  const int presses = connection_->device->take_button_presses() - (unlocked_now ? 1 : 0);

  if (result_lamp_ && std::chrono::steady_clock::now() > result_lamp_end_) result_lamp_.reset();
  const bool unfit = status->local_action_needed || !status->interlock_closed || status->emergency_stop;
  const LampPattern idle = result_lamp_.value_or(LampPattern::ready);
  show_lamp(status->fault_code != 0 ? LampPattern::fault : unfit ? LampPattern::attention : idle);

  std::optional<PressLength> press;
  if (host_button_) press = host_button_->presses().take();
  if (status->local_action_needed) {
    if (press) spdlog::warn("the machine is locked: press the button on the machine itself, then this one again");
    return;
  }
  if (presses > 0) press = follow_press(*status);
  if (press && connection_) obey(*press);
}

void ScanQueue::run(std::uint64_t id) {
  if (host_button_) host_button_->presses().mark();
  const bool simulated = is_simulated(*connection_);
  bool calibrates = false;
  {
    const MutexLock lock(mutex_);
    job(id)->simulated = simulated;
    calibrates = calibrations_.contains(id);
  }
  if (calibrates) return run_calibration_job(id);
  run_scan_job(id);
}

void ScanQueue::run_scan_job(std::uint64_t id) {
  ScanTask task;
  Calibration calibration;
  {
    const MutexLock lock(mutex_);
    calibration = *calibration_;
    const ScanRecord& record = records_.at(id);
    task.request = record.request;
    task.date = record.created;
    task.from_afar = record.requested_by != "button";
    task.log_file = store_.log_file(id);
    task.results_folder = store_.results_folder(id);
    if (!options_.recordings.empty()) task.recording_folder = options_.recordings / std::to_string(id);
    task.warnings = calibration_due(calibration, options_.calibration, records_, std::time(nullptr));
  }
  Observer observer(*this, id);
  auto outcome = run_scan(equipment_of(*connection_, calibration), task, observer);
  if (!outcome && outcome.error().camera_was_gone && connect_again())
    outcome = run_scan(equipment_of(*connection_, calibration), task, observer);

  const ScanState state = outcome ? ScanState::done : outcome.error().state;
  if (outcome) {
    for (const std::string& warning : outcome->warnings) spdlog::warn("scan {}: {}", id, warning);
    for (const SelfCheck& check : outcome->checks) {
      if (check.verdict == CheckVerdict::failed) spdlog::warn("scan {}: check failed: {}", id, sentence_of(check));
    }
    spdlog::info("scan {}: done, {} files in {}", id, outcome->files.size(), task.results_folder.string());
    if (outcome->last_frame_to_step_s > 0) {
      spdlog::info("scan {}: {:.0f} ms from the last frame to the STEP file", id, outcome->last_frame_to_step_s * 1e3);
    }
  } else {
    spdlog::warn("scan {}: {}: {}", id, to_string(state), outcome.error().reason);
  }
  release_machine(state, outcome ? nullptr : &outcome.error());
  change(id, true, [&](ScanRecord& record) {
    record.state = state;
    if (outcome) {
      record.files = outcome->files;
      record.checks = outcome->checks;
      record.progress.fraction = 1;
      record.progress.seconds_left = 0;
    } else {
      record.reason = outcome.error().reason;
      record.failure = outcome.error().failure;
    }
  });
}

/// Lamp, machine and record show what a job does.
void ScanQueue::show_state(std::uint64_t id, ScanState state) {
  spdlog::info("job {}: {}", id, to_string(state));
  show_lamp(lamp_of(state));
  {
    const MutexLock lock(mutex_);
    machine_.state = state;
  }
  change_job(id, [&](JobRecord& record) { record.state = state; });
}

/// First the machine, then the job's record: who hears of its end and asks for another must not meet a machine that is
/// lost. @param stop  nullptr: the job is done
void ScanQueue::release_machine(ScanState ended, const ScanStop* stop) {
  const bool lost = stop != nullptr && (stop->device_lost || stop->camera_lost);
  if (!lost) drop_late_presses();
  result_lamp_ = lamp_of(ended);
  result_lamp_end_ = std::chrono::steady_clock::now() + options_.result_lamp;
  show_lamp(*result_lamp_);
  {
    const MutexLock lock(mutex_);
    machine_.state = ScanState::idle;
    machine_.current_scan = machine_.current_calibration = 0;
  }
  if (lost) lose_connection(stop->reason);
}

/// A camera that was unplugged and plugged in again while nobody looked has to be opened anew.
bool ScanQueue::connect_again() {
  connection_.reset();
  auto connection = connect_(present_calibration());
  if (!connection) return false;
  connection_ = std::move(*connection);
  lamp_ = LampPattern::off;
  return true;
}

ScanEquipment ScanQueue::equipment_of(ScannerConnection& connection, const Calibration& calibration) const {
  return {connection.device.get(), *connection.camera, *connection.clock, calibration,
          connection.truth.get(),  options_.volume};
}

void ScanQueue::lose_connection(const std::string& reason) {
  spdlog::error("connection lost: {}", reason);
  connection_.reset();
  std::deque<std::uint64_t> left;
  {
    const MutexLock lock(mutex_);
    machine_.connected = false;
    machine_.error = reason;
    machine_.laser_on = false;
    left.swap(queue_);
  }
  // What starts by itself when the machine comes back would surprise whoever stands before it.
  for (const std::uint64_t id : left) {
    change_job(id, [&](JobRecord& record) {
      record.state = ScanState::failed;
      record.reason = "The machine was lost before it began: " + reason;
    });
  }
}

void ScanQueue::show_lamp(LampPattern pattern) {
  if (pattern == lamp_ || !connection_ || !connection_->device) return;
  // A lamp that fails is no reason to stop; a lost link shows at the next poll.
  if (connection_->device->set_lamp(pattern)) lamp_ = pattern;
}

void ScanQueue::note_status(const DeviceStatus& status) {
  was_locked_ = status.local_action_needed;
  const MutexLock lock(mutex_);
  machine_.motion = motion_text(status.motion);
  machine_.angle_deg = std::remainder(status.angle_rad * 180 / std::numbers::pi, 360.);
  if (machine_.angle_deg < 0) machine_.angle_deg += 360;
  machine_.interlock_closed = status.interlock_closed;
  machine_.laser_on = status.lasers_on != 0;
  machine_.fault = status.fault_text;
  if (!connection_->device) return;
  machine_.remote_enabled = status.remote_enabled || !connection_->device->capabilities().remote_enable_switch;
  const LinkQuality& link = connection_->device->link_quality();
  machine_.link = {link.requests,
                   link.retries,
                   link.time_outs,
                   link.broken_replies,
                   link.exceptions,
                   link.reconnects,
                   static_cast<double>(link.round_trip_ns) * 1e-6,
                   static_cast<double>(link.longest_round_trip_ns) * 1e-6};
}

bool ScanQueue::nothing_waits() const {
  const MutexLock lock(mutex_);
  return queue_.empty();
}

bool ScanQueue::stopping() const {
  const MutexLock lock(mutex_);
  return stop_;
}

void ScanQueue::sleep(std::chrono::nanoseconds time) {
  const MutexLock lock(mutex_);
  if (!stop_ && queue_.empty()) wake_.wait_for(mutex_, time);
}

/// Until the next look at the machine: a change that it tells of by itself, or a new scan, ends it.
void ScanQueue::rest() {
  if (!connection_ || !connection_->device || !connection_->device->tells_changes()) {
    sleep(options_.poll_period);
    return;
  }
  constexpr std::chrono::nanoseconds kGlance = std::chrono::milliseconds(5);
  const auto woken = [this] {
    const MutexLock lock(mutex_);
    return stop_ || !queue_.empty();
  };
  for (auto left = options_.poll_period; left.count() > 0 && !woken(); left -= kGlance) {
    sleep(kGlance);
    if (connection_->device->changed()) return;
  }
}

}  // namespace celadon
