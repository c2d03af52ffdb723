// Calibrations of the machine by its owner's thread: what clients may see and say while one runs, and what becomes of
// its result.
#include <chrono>
#include <utility>

#include <spdlog/spdlog.h>

#include "daemon/calibration/calibration_file.h"
#include "daemon/calibration/calibration_narrator.h"
#include "daemon/scan_lasers.h"
#include "daemon/scan_queue.h"
#include "daemon/utc_time.h"

namespace celadon {
namespace {

constexpr const char* kCalibrationName = "calibration.toml";  // in the job's folder

std::string refused_steps(const CalibrationOutcome& outcome) {
  std::string names;
  for (const StepVerdict& step : outcome.steps) {
    if (step.verdict == "refused") names += (names.empty() ? "" : ", ") + step.name;
  }
  return names;
}

}  // namespace

/// The operator, wherever he is: what he shall do and what is seen goes into the record, what he says comes from it.
class ScanQueue::CalibrationWatch final : public CalibrationNarrator {
 public:
  CalibrationWatch(ScanQueue& queue, std::uint64_t id, const CalibrationRequest& request)
      : queue_(queue), id_(id), placements_(request.placements) {}

  void ask(const std::string& instruction) override {
    waits_ = holds_ = true;
    note_hand();
    {
      const MutexLock lock(queue_.mutex_);
      queue_.confirmed_ = false;
    }
    queue_.change_calibration(id_, false, [&](CalibrationRecord& record) {
      ++record.step;
      record.instruction = instruction;
    });
    queue_.show_state(id_, ScanState::paused);
  }
  bool done() override {
    from_afar_ = false;
    if (queue_.host_button_begun()) return true;
    const MutexLock lock(queue_.mutex_);
    from_afar_ = std::exchange(queue_.confirmed_, false);
    return from_afar_;
  }
  bool done_from_afar() const override { return from_afar_; }

  void on_look(const BoardLook& look) override {
    if ((look.found && !look.still) || look.views > views_) note_hand();
    views_ = look.views;
    holds_ = true;
    CalibrationNarrator::on_look(look);
    // At once, so that no client sees the sentence of one look beside the other.
    queue_.change_calibration(id_, false, [&](CalibrationRecord& record) {
      record.message = message_;
      record.look = look;
    });
  }
  void on_turn(int placement, int angle, int angles, bool found) override {
    CalibrationNarrator::on_turn(placement, angle, angles, found);
    const BoardTurn turn{placement + 1, placements_, angle, angles, seen()};
    queue_.change_calibration(id_, false, [&](CalibrationRecord& record) {
      record.message = message_;
      record.look.reset();
      record.turn = turn;
    });
  }
  void on_passes(int placement, int frames) override {
    CalibrationNarrator::on_passes(placement, frames);
    tell_message();
  }
  void on_stop(int placement, const AxisStop& stop, bool found) override {
    CalibrationNarrator::on_stop(placement, stop, found);
    tell_message();
  }
  void on_state(ScanState state) override {
    waits_ = holds_ = false;
    note_hand();
    queue_.show_state(id_, state);
  }
  void on_status(const DeviceStatus& status) override { queue_.note_status(status); }
  std::optional<std::string> cancelled() override {
    if (!waits_ && queue_.host_button_begun()) return "by the button";
    {
      const MutexLock lock(queue_.mutex_);
      if (queue_.stop_) return "because the daemon ends";
      if (queue_.cancel_) return queue_.cancel_;
    }
    if (!holds_ || std::chrono::steady_clock::now() - hand_at_ < queue_.options_.longest_wait) return std::nullopt;
    const auto minutes = std::chrono::duration_cast<std::chrono::minutes>(queue_.options_.longest_wait).count();
    return "because no hand did what was asked for within " + std::to_string(minutes) + " minutes";
  }

 protected:
  void say(const std::string& sentence) override {
    spdlog::debug("calibration {}: {}", id_, sentence);
    message_ = sentence;
  }

 private:
  void tell_message() {
    queue_.change_calibration(id_, false, [&](CalibrationRecord& record) { record.message = message_; });
  }
  void note_hand() { hand_at_ = std::chrono::steady_clock::now(); }

  ScanQueue& queue_;
  const std::uint64_t id_;
  const int placements_;
  bool waits_ = false;  ///< for somebody who says that it is done
  bool holds_ = false;  ///< or somebody holds the board: without a hand nothing goes on
  bool from_afar_ = false;
  int views_ = 0;
  std::string message_;
  std::chrono::steady_clock::time_point hand_at_;  ///< the newest sign of one
};

void ScanQueue::run_calibration_job(std::uint64_t id) {
  CalibrationRequest request;
  {
    const MutexLock lock(mutex_);
    request = calibrations_.at(id).request;
  }
  CalibrationWatch watch(*this, id, request);
  auto outcome = options_.run_calibration(*connection_, request, true, watch);
  if (!outcome && outcome.error().camera_was_gone && connect_again())
    outcome = options_.run_calibration(*connection_, request, true, watch);

  std::optional<ScanStop> stop;
  if (!outcome) {
    stop = outcome.error();
  } else if (!outcome->calibration) {
    stop = ScanStop{ScanState::failed,
                    "The calibration is refused, and nothing was changed; follow the remedies of its refused steps: " +
                        refused_steps(*outcome) + ".",
                    false, false, ScanFailure::data};
  } else if (auto adopted = adopt(id, *outcome->calibration); !adopted) {
    stop = adopted.error();
  }
  const ScanState state = stop ? stop->state : ScanState::done;
  if (stop) {
    spdlog::warn("calibration {}: {}: {}", id, to_string(state), stop->reason);
  } else {
    spdlog::info("calibration {}: {}", id, outcome->verdict);
  }
  release_machine(state, stop ? &*stop : nullptr);
  change_calibration(id, true, [&](CalibrationRecord& record) {
    record.state = state;
    record.look.reset();
    record.turn.reset();
    if (outcome) {
      record.verdict = outcome->verdict;
      record.steps = outcome->steps;
      record.values = outcome->values;
    }
    if (stop) {
      record.reason = stop->reason;
      record.failure = stop->failure;
    } else {
      record.files = {kCalibrationName};
    }
  });
}

/// Writes a calibration that passed; the next scan uses it.
tl::expected<void, ScanStop> ScanQueue::adopt(std::uint64_t id, const Calibration& calibration) {
  show_state(id, ScanState::exporting);
  const std::string text = format_calibration(calibration);
  std::filesystem::path folder;
  std::string previous_date;
  {
    const MutexLock lock(mutex_);
    folder = store_.calibration_folder(id);
    if (calibration_) previous_date = calibration_->date;
  }
  const auto failed = [](const WriteError& error) {
    return tl::make_unexpected(ScanStop{ScanState::failed, error.message, false, false, ScanFailure::system});
  };
  if (auto written = write_file_atomically(folder / kCalibrationName, text); !written) return failed(written.error());
  auto kept = replace_calibration(options_.calibration_file, text, previous_date);
  if (!kept) return failed(kept.error());
  spdlog::info("calibration {}: {} is in use{}", id, options_.calibration_file.string(),
               kept->empty() ? "" : "; the one before is " + kept->string());
  const MutexLock lock(mutex_);
  calibration_ = calibration;
  machine_.calibrated = calibration.date;
  return {};
}

tl::expected<CalibrationRecord, ServiceError> ScanQueue::calibrate(const CalibrationRequest& request,
                                                                   const std::string& requested_by) {
  CalibrationRecord record;
  record.request = request;
  record.requested_by = requested_by;
  {
    const MutexLock lock(mutex_);
    if (const auto why = closed()) return tl::make_unexpected(*why);
    if (options_.camera_url.starts_with("replay:")) {
      return tl::make_unexpected(ServiceError{
          409, "no machine",
          "The camera is the recording " + options_.camera_url + "; calibrate with a daemon that has a machine."});
    }
    if (auto taken = take(record); !taken) return tl::make_unexpected(taken.error());
  }
  spdlog::info("calibration {}: queued by {}", record.id, requested_by);
  tell(record.id);
  return record;
}

tl::expected<void, ServiceError> ScanQueue::take(CalibrationRecord& record) {
  auto id = store_.new_calibration();
  if (!id) return tl::make_unexpected(ServiceError{507, "no storage", id.error().message});
  record.id = *id;
  record.created = utc_now();
  record.simulated = machine_.simulated;
  record.folder = store_.calibration_folder(*id);
  if (auto saved = store_.save(record); !saved)
    return tl::make_unexpected(ServiceError{507, "no storage", saved.error().message});
  calibrations_.emplace(*id, record);
  queue_.push_back(*id);
  wake_.notify_all();
  return {};
}

std::vector<CalibrationRecord> ScanQueue::calibrations() const {
  const MutexLock lock(mutex_);
  std::vector<CalibrationRecord> all;
  all.reserve(calibrations_.size());
  for (const auto& [id, record] : calibrations_) all.push_back(record);
  return all;
}

std::optional<CalibrationRecord> ScanQueue::calibration(std::uint64_t id) const {
  const MutexLock lock(mutex_);
  const auto found = calibrations_.find(id);
  if (found == calibrations_.end()) return std::nullopt;
  return found->second;
}

tl::expected<void, ServiceError> ScanQueue::confirm(std::uint64_t id, std::optional<int> step) {
  const std::string its = "Calibration " + std::to_string(id) + " ";
  {
    const MutexLock lock(mutex_);
    const auto found = calibrations_.find(id);
    if (found == calibrations_.end()) {
      return tl::make_unexpected(
          ServiceError{404, "no such calibration", "There is no calibration " + std::to_string(id) + "."});
    }
    CalibrationRecord& record = found->second;
    if (record.state != ScanState::paused) {
      return tl::make_unexpected(
          ServiceError{409, "waits for no hand",
                       its + "is " + to_string(record.state) + "; confirm it once it is paused and asks for a hand."});
    }
    if (step && *step != record.step) {
      return tl::make_unexpected(ServiceError{409, "another step",
                                              its + "asks for step " + std::to_string(record.step) + ", not " +
                                                  std::to_string(*step) + ": " + record.instruction});
    }
    // At once, so that a second confirm of the same step is none of the next.
    record.state = ScanState::preparing;
    confirmed_ = true;
  }
  tell(id);
  return {};
}

}  // namespace celadon
