#pragma once
// The queue of jobs, scans and calibrations, and the one thread that owns machine and camera. Button, command line and
// network are its clients.

#include <chrono>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "daemon/button_options.h"
#include "daemon/calibration/calibration_job.h"
#include "daemon/scan_job.h"
#include "daemon/scan_service.h"
#include "daemon/scan_store.h"
#include "daemon/scanner_connection.h"
#include "daemon/thread_annotations.h"

namespace celadon {

struct ScanQueueOptions {
  std::string device_url, camera_url;  ///< as shown to clients
  ScanRequest button_request;          ///< what a press starts
  ButtonOptions button = {};
  ScanVolume volume;
  CalibrationLimits calibration = {};
  std::filesystem::path recordings = {};  ///< folder for the frames of each scan; empty: they are not kept
  RunCalibration run_calibration = {};
  std::filesystem::path calibration_file = {};  ///< that a calibration replaces
  std::size_t longest_queue = 100;
  std::chrono::nanoseconds poll_period = std::chrono::milliseconds(50);   ///< idle; real time
  std::chrono::nanoseconds first_retry = std::chrono::milliseconds(500);  ///< of a connection; doubles up to
  std::chrono::nanoseconds longest_retry = std::chrono::seconds(8);       ///< this
  std::chrono::nanoseconds result_lamp = std::chrono::seconds(20);        ///< how long the lamp shows how a job ended
  std::chrono::nanoseconds longest_wait = std::chrono::minutes(15);       ///< of a calibration for a hand; real time
};

class ScanQueue final : public ScanService {
 public:
  /// Opens machine and camera and checks them against the present calibration, if there is one.
  using Connect =
      std::function<tl::expected<ScannerConnection, ConnectError>(const std::optional<Calibration>& calibration)>;

  /// @param calibration  nullopt: there is none yet, and scans are refused. @pre not with a recording
  ScanQueue(ScanStore store, std::optional<Calibration> calibration, ScanQueueOptions options, Connect connect);
  ~ScanQueue() override;  ///< stops

  /// Starts the owner's thread and returns after its first attempt to connect. Fails only for what trying again cannot
  /// help; an absent machine is waited for.
  tl::expected<void, ConnectError> start() CELADON_EXCLUDES(mutex_);
  /// Cancels what runs, makes the machine safe, ends the thread. Queued jobs are cancelled.
  void stop() CELADON_EXCLUDES(mutex_);
  /// Devices came to this computer or left it: an absent machine is looked for now, not at the next retry. From any
  /// thread.
  void devices_changed() CELADON_EXCLUDES(mutex_);

  MachineState machine() const override CELADON_EXCLUDES(mutex_);
  tl::expected<ScanRecord, ServiceError> submit(const ScanRequest& request, const std::string& requested_by) override
      CELADON_EXCLUDES(mutex_);
  std::vector<ScanRecord> scans() const override CELADON_EXCLUDES(mutex_);
  std::optional<ScanRecord> scan(std::uint64_t id) const override CELADON_EXCLUDES(mutex_);
  tl::expected<CalibrationRecord, ServiceError> calibrate(const CalibrationRequest& request,
                                                          const std::string& requested_by) override
      CELADON_EXCLUDES(mutex_);
  std::vector<CalibrationRecord> calibrations() const override CELADON_EXCLUDES(mutex_);
  std::optional<CalibrationRecord> calibration(std::uint64_t id) const override CELADON_EXCLUDES(mutex_);
  tl::expected<void, ServiceError> confirm(std::uint64_t id, std::optional<int> step) override CELADON_EXCLUDES(mutex_);
  tl::expected<void, ServiceError> cancel(std::uint64_t id) override CELADON_EXCLUDES(mutex_);
  std::uint64_t subscribe(std::function<void(std::uint64_t id)> listener) override CELADON_EXCLUDES(listeners_mutex_);
  void unsubscribe(std::uint64_t subscription) override CELADON_EXCLUDES(listeners_mutex_);

 private:
  class Observer;
  class TestObserver;
  class CalibrationWatch;

  // The owner's thread, from top to bottom (machine_owner.cpp).
  void own_machine() CELADON_EXCLUDES(mutex_);
  void connect() CELADON_EXCLUDES(mutex_);
  void watch_machine() CELADON_EXCLUDES(mutex_);
  void run(std::uint64_t id) CELADON_EXCLUDES(mutex_);
  void run_scan_job(std::uint64_t id) CELADON_EXCLUDES(mutex_);
  void show_state(std::uint64_t id, ScanState state) CELADON_EXCLUDES(mutex_);
  void release_machine(ScanState ended, const ScanStop* stop) CELADON_EXCLUDES(mutex_);
  // Calibrations (machine_calibration.cpp).
  void run_calibration_job(std::uint64_t id) CELADON_EXCLUDES(mutex_);
  tl::expected<void, ScanStop> adopt(std::uint64_t id, const Calibration& calibration) CELADON_EXCLUDES(mutex_);
  // What presses ask for (machine_button.cpp).
  void look_at_host_button() CELADON_EXCLUDES(mutex_);
  bool host_button_begun() CELADON_EXCLUDES(mutex_);
  void drop_late_presses() CELADON_EXCLUDES(mutex_);
  std::optional<PressLength> follow_press(DeviceStatus status) CELADON_EXCLUDES(mutex_);
  void obey(PressLength press) CELADON_EXCLUDES(mutex_);
  void test_machine() CELADON_EXCLUDES(mutex_);
  bool connect_again();
  ScanEquipment equipment_of(ScannerConnection& connection, const Calibration& calibration) const;
  void lose_connection(const std::string& reason) CELADON_EXCLUDES(mutex_);
  void show_lamp(LampPattern pattern);

  void note_status(const DeviceStatus& status) CELADON_EXCLUDES(mutex_);
  /// Changes a record, saves it if asked to, tells the listeners.
  void change(std::uint64_t id, bool save, const std::function<void(ScanRecord&)>& edit) CELADON_EXCLUDES(mutex_);
  void change_calibration(std::uint64_t id, bool save, const std::function<void(CalibrationRecord&)>& edit)
      CELADON_EXCLUDES(mutex_);
  /// Of either kind; saves it.
  void change_job(std::uint64_t id, const std::function<void(JobRecord&)>& edit) CELADON_EXCLUDES(mutex_);
  void tell(std::uint64_t id) CELADON_EXCLUDES(listeners_mutex_, mutex_);
  JobRecord* job(std::uint64_t id) CELADON_REQUIRES(mutex_);  ///< nullptr: there is none
  void save(std::uint64_t id) CELADON_REQUIRES(mutex_);
  /// Why no job can be taken now.
  std::optional<ServiceError> closed() const CELADON_REQUIRES(mutex_);
  /// Takes a job into store and queue.
  tl::expected<void, ServiceError> take(ScanRecord& record) CELADON_REQUIRES(mutex_);
  tl::expected<void, ServiceError> take(CalibrationRecord& record) CELADON_REQUIRES(mutex_);
  std::optional<Calibration> present_calibration() const CELADON_EXCLUDES(mutex_);
  bool stopping() const CELADON_EXCLUDES(mutex_);
  bool nothing_waits() const CELADON_EXCLUDES(mutex_);
  void sleep(std::chrono::nanoseconds time) CELADON_EXCLUDES(mutex_);
  void rest() CELADON_EXCLUDES(mutex_);

  const ScanQueueOptions options_;
  const Connect connect_;

  // Of the owner's thread alone.
  std::optional<ScannerConnection> connection_;
  std::chrono::nanoseconds retry_;
  LampPattern lamp_ = LampPattern::off;
  std::optional<LampPattern> result_lamp_;  ///< how the last job ended, until result_lamp_end_
  std::chrono::steady_clock::time_point result_lamp_end_;
  std::optional<HostButton> host_button_;
  bool was_locked_ = false;  ///< the newest status asked for a press on the machine

  mutable Mutex mutex_;
  Condition wake_;
  ScanStore store_ CELADON_GUARDED_BY(mutex_);
  std::optional<Calibration> calibration_ CELADON_GUARDED_BY(mutex_);
  std::map<std::uint64_t, ScanRecord> records_ CELADON_GUARDED_BY(mutex_);
  std::map<std::uint64_t, CalibrationRecord> calibrations_ CELADON_GUARDED_BY(mutex_);
  std::deque<std::uint64_t> queue_ CELADON_GUARDED_BY(mutex_);
  MachineState machine_ CELADON_GUARDED_BY(mutex_);
  std::optional<std::string> cancel_ CELADON_GUARDED_BY(mutex_);  ///< of the running job: by whom
  bool confirmed_ CELADON_GUARDED_BY(mutex_) = false;             ///< what the running calibration asked for is done
  std::optional<ConnectError> refused_ CELADON_GUARDED_BY(mutex_);
  bool first_attempt_done_ CELADON_GUARDED_BY(mutex_) = false, stop_ CELADON_GUARDED_BY(mutex_) = false;
  bool devices_changed_ CELADON_GUARDED_BY(mutex_) = false;  ///< since the last attempt to connect began

  Mutex listeners_mutex_;
  std::map<std::uint64_t, std::function<void(std::uint64_t)>> listeners_ CELADON_GUARDED_BY(listeners_mutex_);
  std::uint64_t last_subscription_ CELADON_GUARDED_BY(listeners_mutex_) = 0;

  std::thread thread_;
};

}  // namespace celadon
