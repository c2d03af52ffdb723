#include "daemon/scan_queue.h"

#include <algorithm>
#include <ctime>

#include <spdlog/spdlog.h>

#include "daemon/calibration_due.h"
#include "daemon/scan_lasers.h"
#include "daemon/scan_stops.h"

namespace celadon {
namespace {

std::string utc_now() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  gmtime_r(&now, &parts);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text;
}

}  // namespace

ScanQueue::ScanQueue(ScanStore store, Calibration calibration, ScanQueueOptions options, Connect connect)
    : calibration_(std::move(calibration)),
      options_(std::move(options)),
      connect_(std::move(connect)),
      retry_(options_.first_retry),
      store_(std::move(store)) {
  if (options_.button.open) host_button_.emplace(options_.button.open, options_.button.timing);
  const MutexLock lock(mutex_);
  std::vector<std::string> problems;
  for (ScanRecord& record : store_.load(problems)) records_.emplace(record.id, std::move(record));
  for (const std::string& problem : problems) spdlog::warn("{}", problem);
  machine_.device_url = options_.device_url;
  machine_.camera_url = options_.camera_url;
  machine_.calibrated = calibration_.date;
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

void ScanQueue::save(const ScanRecord& record) {
  if (auto saved = store_.save(record); !saved) spdlog::error("scan {}: {}", record.id, saved.error().message);
}

void ScanQueue::change(std::uint64_t id, bool saved, const std::function<void(ScanRecord&)>& edit) {
  {
    const MutexLock lock(mutex_);
    ScanRecord& record = records_.at(id);
    edit(record);
    if (saved) save(record);
  }
  tell(id);
}

void ScanQueue::tell(std::uint64_t id) {
  // Listeners read the record under this lock: of two threads that tell at once none lets them see an older state last.
  const MutexLock lock(listeners_mutex_);
  for (const auto& [subscription, listener] : listeners_) listener(id);
}

MachineState ScanQueue::machine() const {
  const MutexLock lock(mutex_);
  MachineState machine = machine_;
  machine.calibration_due = calibration_due(calibration_, options_.calibration, records_, std::time(nullptr));
  return machine;
}

tl::expected<ScanRecord, ServiceError> ScanQueue::submit(const ScanRequest& request, const std::string& requested_by) {
  ScanRecord record;
  {
    const MutexLock lock(mutex_);
    if (stop_) return tl::make_unexpected(ServiceError{503, "ending", "The daemon is ending; start it again."});
    if (!machine_.connected) {
      return tl::make_unexpected(ServiceError{503, "no machine", "No machine is connected: " + machine_.error});
    }
    if (const auto lasers = lasers_of(request, calibration_, machine_.lasers); !lasers) {
      return tl::make_unexpected(ServiceError{422, "no such laser", lasers.error()});
    }
    // A recording has stops of its own.
    if (!machine_.device_url.empty()) {
      if (const auto stops = stops_of(request, calibration_, machine_.travels); !stops)
        return tl::make_unexpected(ServiceError{422, "no such stop", stops.error()});
    }
    if (queue_.size() >= options_.longest_queue) {
      return tl::make_unexpected(ServiceError{
          429, "queue full", std::to_string(queue_.size()) + " scans are waiting already; cancel some or wait."});
    }
    auto id = store_.new_scan();
    if (!id) return tl::make_unexpected(ServiceError{507, "no storage", id.error().message});
    record.id = *id;
    record.request = request;
    record.requested_by = requested_by;
    record.state = ScanState::queued;
    record.created = utc_now();
    record.simulated = machine_.simulated;
    record.folder = store_.results_folder(*id);
    if (auto saved = store_.save(record); !saved) {
      return tl::make_unexpected(ServiceError{507, "no storage", saved.error().message});
    }
    records_.emplace(*id, record);
    queue_.push_back(*id);
    wake_.notify_all();
  }
  spdlog::info("scan {}: queued by {}", record.id, requested_by);
  tell(record.id);
  return record;
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
    const auto found = records_.find(id);
    if (found == records_.end()) {
      return tl::make_unexpected(ServiceError{404, "no such scan", "There is no scan " + std::to_string(id) + "."});
    }
    ScanRecord& record = found->second;
    if (is_final(record.state)) {
      return tl::make_unexpected(ServiceError{
          409, "already over",
          "Scan " + std::to_string(id) + " is " + to_string(record.state) + " already; there is nothing to cancel."});
    }
    const auto waiting = std::find(queue_.begin(), queue_.end(), id);
    if (waiting == queue_.end()) {
      cancel_ = "on request";
      return {};
    }
    queue_.erase(waiting);
    record.state = ScanState::cancelled;
    record.reason = "It was cancelled on request before it began; start again.";
    save(record);
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
