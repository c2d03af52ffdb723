#include "daemon/scan_queue.h"

#include <algorithm>
#include <ctime>

#include <spdlog/spdlog.h>

#include "daemon/calibration_due.h"
#include "daemon/scan_lasers.h"
#include "daemon/scan_stops.h"
#include "daemon/utc_time.h"

namespace celadon {
namespace {

constexpr const char* kNotCalibrated =
    "The machine is not calibrated; calibrate first: celadon calibrate, or POST /api/v1/calibrations.";

}  // namespace

ScanQueue::ScanQueue(ScanStore store, std::optional<Calibration> calibration, ScanQueueOptions options, Connect connect)
    : options_(std::move(options)),
      connect_(std::move(connect)),
      retry_(options_.first_retry),
      store_(std::move(store)) {
  if (options_.button.open) host_button_.emplace(options_.button.open, options_.button.timing);
  const MutexLock lock(mutex_);
  calibration_ = std::move(calibration);
  std::vector<std::string> problems;
  for (ScanRecord& record : store_.load(problems)) records_.emplace(record.id, std::move(record));
  for (CalibrationRecord& record : store_.load_calibrations(problems))
    calibrations_.emplace(record.id, std::move(record));
  for (const std::string& problem : problems) spdlog::warn("{}", problem);
  machine_.device_url = options_.device_url;
  machine_.camera_url = options_.camera_url;
  if (calibration_) machine_.calibrated = calibration_->date;
}

ScanQueue::~ScanQueue() {
  stop();
}

tl::expected<void, ConnectError> ScanQueue::start() {
  thread_ = std::thread([this] { own_machine(); });
  const MutexLock lock(mutex_);
  while (!first_attempt_done_) wake_.wait(mutex_);
  if (refused_) return tl::make_unexpected(*refused_);
  return {};
}

void ScanQueue::stop() {
  {
    const MutexLock lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  if (thread_.joinable()) thread_.join();
}

JobRecord* ScanQueue::job(std::uint64_t id) {
  if (const auto scan = records_.find(id); scan != records_.end()) return &scan->second;
  if (const auto calibration = calibrations_.find(id); calibration != calibrations_.end()) return &calibration->second;
  return nullptr;
}

void ScanQueue::save(std::uint64_t id) {
  const auto scan = records_.find(id);
  auto saved = scan != records_.end() ? store_.save(scan->second) : store_.save(calibrations_.at(id));
  if (!saved) spdlog::error("job {}: {}", id, saved.error().message);
}

void ScanQueue::change(std::uint64_t id, bool saved, const std::function<void(ScanRecord&)>& edit) {
  {
    const MutexLock lock(mutex_);
    edit(records_.at(id));
    if (saved) save(id);
  }
  tell(id);
}

void ScanQueue::change_calibration(std::uint64_t id, bool saved, const std::function<void(CalibrationRecord&)>& edit) {
  {
    const MutexLock lock(mutex_);
    edit(calibrations_.at(id));
    if (saved) save(id);
  }
  tell(id);
}

void ScanQueue::change_job(std::uint64_t id, const std::function<void(JobRecord&)>& edit) {
  {
    const MutexLock lock(mutex_);
    edit(*job(id));
    save(id);
  }
  tell(id);
}

void ScanQueue::tell(std::uint64_t id) {
  // Listeners read the record under this lock: of two threads that tell at once none lets them see an older state last.
  const MutexLock lock(listeners_mutex_);
  for (const auto& [subscription, listener] : listeners_) listener(id);
}

void ScanQueue::devices_changed() {
  const MutexLock lock(mutex_);
  devices_changed_ = true;
  wake_.notify_all();
}

MachineState ScanQueue::machine() const {
  const MutexLock lock(mutex_);
  MachineState machine = machine_;
  machine.calibration_due = calibration_
                                ? calibration_due(*calibration_, options_.calibration, records_, std::time(nullptr))
                                : std::vector<std::string>{kNotCalibrated};
  return machine;
}

std::optional<Calibration> ScanQueue::present_calibration() const {
  const MutexLock lock(mutex_);
  return calibration_;
}

std::optional<ServiceError> ScanQueue::closed() const {
  if (stop_) return ServiceError{503, "ending", "The daemon is ending; start it again."};
  if (!machine_.connected) return ServiceError{503, "no machine", "No machine is connected: " + machine_.error};
  if (queue_.size() < options_.longest_queue) return std::nullopt;
  return ServiceError{429, "queue full",
                      std::to_string(queue_.size()) + " jobs are waiting already; cancel some or wait."};
}

tl::expected<ScanRecord, ServiceError> ScanQueue::submit(const ScanRequest& request, const std::string& requested_by) {
  ScanRecord record;
  record.request = request;
  record.requested_by = requested_by;
  {
    const MutexLock lock(mutex_);
    if (const auto why = closed()) return tl::make_unexpected(*why);
    if (!calibration_) return tl::make_unexpected(ServiceError{409, "not calibrated", kNotCalibrated});
    if (const auto lasers = lasers_of(request, *calibration_, machine_.lasers); !lasers) {
      return tl::make_unexpected(ServiceError{422, "no such laser", lasers.error()});
    }
    // A recording has stops of its own.
    if (!machine_.device_url.empty()) {
      if (const auto stops = stops_of(request, *calibration_, machine_.travels); !stops)
        return tl::make_unexpected(ServiceError{422, "no such stop", stops.error()});
    }
    if (auto taken = take(record); !taken) return tl::make_unexpected(taken.error());
  }
  spdlog::info("scan {}: queued by {}", record.id, requested_by);
  tell(record.id);
  return record;
}

tl::expected<void, ServiceError> ScanQueue::take(ScanRecord& record) {
  auto id = store_.new_scan();
  if (!id) return tl::make_unexpected(ServiceError{507, "no storage", id.error().message});
  record.id = *id;
  record.created = utc_now();
  record.simulated = machine_.simulated;
  record.folder = store_.results_folder(*id);
  if (auto saved = store_.save(record); !saved)
    return tl::make_unexpected(ServiceError{507, "no storage", saved.error().message});
  records_.emplace(*id, record);
  queue_.push_back(*id);
  wake_.notify_all();
  return {};
}

std::vector<ScanRecord> ScanQueue::scans() const {
  const MutexLock lock(mutex_);
  std::vector<ScanRecord> all;
  all.reserve(records_.size());
  for (const auto& [id, record] : records_) all.push_back(record);
  return all;
}

std::optional<ScanRecord> ScanQueue::scan(std::uint64_t id) const {
  const MutexLock lock(mutex_);
  const auto found = records_.find(id);
  if (found == records_.end()) return std::nullopt;
  return found->second;
}

tl::expected<void, ServiceError> ScanQueue::cancel(std::uint64_t id) {
  {
    const MutexLock lock(mutex_);
    JobRecord* const found = job(id);
    if (found == nullptr) {
      return tl::make_unexpected(ServiceError{404, "no such job", "There is no job " + std::to_string(id) + "."});
    }
    if (is_final(found->state)) {
      return tl::make_unexpected(ServiceError{
          409, "already over",
          "Job " + std::to_string(id) + " is " + to_string(found->state) + " already; there is nothing to cancel."});
    }
    const auto waiting = std::find(queue_.begin(), queue_.end(), id);
    if (waiting == queue_.end()) {
      cancel_ = "on request";
      return {};
    }
    queue_.erase(waiting);
    found->state = ScanState::cancelled;
    found->reason = "It was cancelled on request before it began; start again.";
    save(id);
  }
  tell(id);
  return {};
}

std::uint64_t ScanQueue::subscribe(std::function<void(std::uint64_t id)> listener) {
  const MutexLock lock(listeners_mutex_);
  listeners_.emplace(++last_subscription_, std::move(listener));
  return last_subscription_;
}

void ScanQueue::unsubscribe(std::uint64_t subscription) {
  const MutexLock lock(listeners_mutex_);
  listeners_.erase(subscription);
}

}  // namespace celadon
