#include "tests/integration/fault_matrix.h"

#include <atomic>
#include <condition_variable>
#include <filesystem>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "daemon/profile_log.h"
#include "daemon/scan_queue.h"
#include "daemon/sim_control.h"
#include "sim/server.h"
#include "tests/temporary_folder.h"

namespace celadon::testing {
namespace {

using nlohmann::json;
using std::chrono::milliseconds;

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kLease_ns = 500 * kMs;
constexpr std::int64_t kDarkLimit_ns = 100 * kMs;   // after detection
constexpr std::int64_t kLongest_ns = 90'000 * kMs;  // of device time, from the fault to the end of the scan
constexpr auto kHang = std::chrono::seconds(30);    // of real time: only for a cell that would never end

sim::ServerOptions machine_options(const TemporaryFolder& folder, std::uint64_t seed, bool serial) {
  sim::ServerOptions options;
  sim::CameraConfig camera;
  camera.width_px = 320;
  camera.height_px = 256;
  options.device = sim::default_device(camera);
  options.device.scene = "vase";
  options.device.seed = seed;
  options.device.date = "2026-01-02T03:04:05Z";
  options.lock_step = true;
  options.socket_dir = folder / "sim";
  if (serial) {
    options.modbus_tcp.clear();
    options.modbus_rtu = true;
    options.modbus_rtu_link = folder / "tty";
  }
  return options;
}

/// The virtual scanner, served by a thread of its own.
class Machine {
 public:
  Machine(const TemporaryFolder& folder, std::uint64_t seed, bool serial) {
    const sim::ServerOptions options = machine_options(folder, seed, serial);
    calibration = sim::DeviceModel(options.device).calibration();
    auto server = sim::Server::open(options);
    if (!server) throw std::runtime_error(server.error());
    server_ = std::move(*server);
    thread_ = std::thread([this] { server_->run(); });
    auto control = SimControl::open(options.socket_dir);
    if (!control) throw std::runtime_error(control.error());
    control_ = std::move(*control);
    folder_ = options.socket_dir;
  }
  ~Machine() {
    server_->stop();
    thread_.join();
  }
  std::string url() const { return server_->modbus_url() + "?timeout_ms=400"; }
  std::string camera_url() const { return "sim:" + folder_.string(); }

  /// From any thread.
  json ask(const std::string& request) {
    const std::lock_guard lock(mutex_);
    auto answer = control_->ask(request);
    if (!answer) throw std::runtime_error(answer.error());
    return std::move(*answer);
  }
  json state() { return ask("state"); }
  void pass(std::int64_t duration_ns) {
    ask("wait-until " + std::to_string(ask("time")["time_ns"].get<std::int64_t>() + duration_ns));
  }

  Calibration calibration;

 private:
  std::unique_ptr<sim::Server> server_;
  std::thread thread_;
  std::filesystem::path folder_;
  std::mutex mutex_;
  std::unique_ptr<SimControl> control_;
};

/// The scan service on that machine. The order is given when a scan enters a state.
class Service {
 public:
  Service(Machine& machine, const TemporaryFolder& folder, bool polls_when_idle) : machine_(machine) {
    auto store = ScanStore::open(folder / "store");
    if (!store) throw std::runtime_error(store.error().message);
    ScanQueueOptions options;
    options.device_url = machine.url();
    options.camera_url = machine.camera_url();
    // Each idle poll takes bus time: without them a cell runs through the same instants every time.
    options.poll_period = polls_when_idle ? milliseconds(2) : milliseconds(3'600'000);
    options.first_retry = options.longest_retry = milliseconds(5);
    // A button that sticks or chatters presses. What it asks an idle machine for would run, as ordered, between the
    // cell's scans; that it stops a scan is what a cell looks at.
    options.button.brief = options.button.lasting = PressMeaning::nothing;
    queue_ = std::make_unique<ScanQueue>(std::move(*store), machine.calibration, options, [&machine](const auto&) {
      return connect_scanner(machine.url(), machine.camera_url(), machine.calibration);
    });
    queue_->subscribe([this, q = queue_.get()](std::uint64_t id) { note(*q->scan(id)); });
    if (auto started = queue_->start(); !started) throw std::runtime_error(started.error().message);
    wait([this] { return !queue_->machine().motion.empty(); });
  }
  ~Service() { queue_.reset(); }

  void give_order_at(const std::string& state, const std::string& order) {
    const std::lock_guard lock(mutex_);
    order_state_ = state;
    order_ = order;
  }
  tl::expected<ScanRecord, ServiceError> submit(bool step) {
    ScanRequest request;
    request.profiles = 16;
    request.mode = step ? ScanMode::step : ScanMode::sweep;
    request.formats = {"surface.json"};
    return queue_->submit(request, "api");
  }
  /// The scan once it is over; nullopt: it hangs.
  std::optional<ScanRecord> end_of(std::uint64_t id) {
    std::unique_lock lock(mutex_);
    const bool over = changed_.wait_for(lock, kHang, [&] { return last_.id == id && is_final(last_.state); });
    if (over) return last_;
    lock.unlock();
    (void)queue_->cancel(id);
    return std::nullopt;
  }
  /// Device time at which that scan was over.
  std::int64_t end_ns() const { return end_ns_; }
  bool connected_within(std::chrono::milliseconds limit) {
    return wait([this] { return queue_->machine().connected; }, limit);
  }
  MachineState machine() const { return queue_->machine(); }

  template <class Condition>
  static bool wait(Condition condition, std::chrono::milliseconds limit = milliseconds(20'000)) {
    const auto end = std::chrono::steady_clock::now() + limit;
    while (!condition()) {
      if (std::chrono::steady_clock::now() > end) return false;
      std::this_thread::yield();
    }
    return true;
  }

 private:
  void note(const ScanRecord& record) {
    std::string order;
    {
      const std::lock_guard lock(mutex_);
      if (!order_.empty() && record.state != last_state_ && to_string(record.state) == order_state_) order.swap(order_);
      last_state_ = record.state;
    }
    if (!order.empty()) machine_.ask("fault " + order);
    const std::int64_t now_ns = is_final(record.state) ? machine_.state()["time_ns"].get<std::int64_t>() : 0;
    const std::lock_guard lock(mutex_);
    last_ = record;
    if (now_ns > 0) end_ns_ = now_ns;
    changed_.notify_all();
  }

  Machine& machine_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::string order_state_, order_;
  ScanState last_state_ = ScanState::idle;
  ScanRecord last_;
  std::atomic<std::int64_t> end_ns_ = 0;
  std::unique_ptr<ScanQueue> queue_;
};

bool moves(const json& state) {
  const std::string motion = state["motion"];
  return motion == "homing" || motion == "moving" || motion == "settling" || state["motor_speed_rad_per_s"] != 0.0;
}

std::string warnings_of(const ScanRecord& record) {
  const json report = json::parse(read_file(record.folder / "report.json"), nullptr, false);
  std::string all;
  if (report.is_object()) {
    for (const auto& warning : report.value("warnings", json::array())) {
      // Sixteen profiles do not meet a rim all around.
      const std::string text = warning;
      if (text.find("measured but not all around") == std::string::npos) all += text + " ";
    }
  }
  return all;
}

/// What is wrong with the log of a scan that had taken profiles; empty: nothing.
std::string fault_of_log(const std::filesystem::path& file) {
  auto log = ProfileLogReader::open(file);
  if (!log) return log.error().message;
  int profiles = 0;
  while ((*log)->next() != nullptr) ++profiles;
  if (!(*log)->error().empty()) return (*log)->error();
  if ((*log)->torn_bytes() != 0) return "the log is torn";
  return profiles > 0 ? "" : "the log has no profiles";
}

bool contains_any(const std::string& text, const std::vector<std::string>& words) {
  for (const std::string& word : words) {
    if (text.find(word) != std::string::npos) return true;
  }
  return false;
}

/// Laser and motor after the fault, from the machine's own side.
void judge_safety(Machine& machine, const FaultCase& fault, std::int64_t end_ns, CellResult& cell) {
  machine.pass(1'500 * kMs);
  const json now = machine.state();
  const auto at = [&](const char* key) { return now[key].get<std::int64_t>(); };
  const std::string order = fault.order;
  const bool glued = order == "laser-stuck-on" || order == "laser-hidden";
  const std::int64_t struck = at("struck_ns"), dark = at("dark_since_ns");
  if (now["lease_left_ms"] != 0) cell.bad.push_back("a lease runs on");
  if (moves(now)) cell.bad.push_back("the motor runs on");
  if (struck == 0) cell.bad.push_back("the fault never came");
  if (glued) return;
  if (dark == 0) {
    cell.bad.push_back("the laser shines");
    return;
  }
  if (cell.outcome != "done" && cell.outcome != "continued" && dark > struck)
    cell.dark_ms = static_cast<double>(dark - struck) / 1e6;
  const std::int64_t limit = (fault.breaks_link && !fault.serial ? struck + kLease_ns : end_ns) + kDarkLimit_ns;
  if (dark > limit)
    cell.bad.push_back("the laser went out " + std::to_string((dark - limit) / kMs + 100) + " ms after the detection");
  const std::int64_t faulted = at("fault_since_ns");
  if (faulted > 0 && dark > faulted + kDarkLimit_ns && dark > struck)
    cell.bad.push_back("the laser shone on for " + std::to_string((dark - faulted) / kMs) +
                       " ms after the controller's fault");
}

/// After the fault is taken back nothing starts by itself; a press where one is asked for, and a scan is done again.
void judge_recovery(Machine& machine, Service& service, const FaultCase& fault, CellResult& cell) {
  const std::string name = std::string(fault.order).substr(0, std::string(fault.order).find(' '));
  machine.ask("clear " + name);
  machine.pass(1'500 * kMs);
  const json now = machine.state();
  if (moves(now) || now["lasers_on"] != 0) cell.bad.push_back("something went on by itself after the fault was gone");
  if (!service.connected_within(milliseconds(20'000))) {
    cell.bad.push_back("the machine is not found again: " + service.machine().error);
    return;
  }
  if (now["local_action_needed"] == true) {
    if (auto locked = service.submit(false)) {
      const auto end = service.end_of(locked->id);
      if (!end || end->state != ScanState::failed || end->reason.find("press the button") == std::string::npos)
        cell.bad.push_back("a locked machine scanned or did not ask for the press");
    }
    machine.ask("press");
    machine.pass(500 * kMs);
  }
  std::optional<ScanRecord> end;
  for (int attempt = 0; attempt < 3; ++attempt) {
    auto again = service.submit(false);
    if (again) end = service.end_of(again->id);
    // The service may be noticing only now that the machine was gone.
    const bool late = again ? end && end->reason.rfind("The machine was lost before", 0) == 0 : fault.breaks_link;
    if (!late || !service.connected_within(milliseconds(20'000))) break;
  }
  if (!end || end->state != ScanState::done)
    cell.bad.push_back("the next scan: " + (end ? to_string(end->state) + (" " + end->reason) : "hangs or is refused"));
}

}  // namespace

CellResult try_cell(const FaultCase& fault, const FaultMoment& moment, std::uint64_t seed) {
  const TemporaryFolder folder;
  Machine machine(folder, seed, fault.serial);
  const bool idle = moment.state[0] == '\0';
  CellResult cell;
  Service service(machine, folder, idle);
  if (idle) {
    machine.ask("fault " + std::string(fault.order));
    const std::int64_t since = machine.ask("time")["time_ns"];
    machine.pass(300 * kMs);
    // A few looks of the idle daemon, or the loss of the machine.
    Service::wait([&] {
      return !service.machine().connected || machine.ask("time")["time_ns"].get<std::int64_t>() > since + 310 * kMs;
    });
  } else {
    service.give_order_at(moment.state, std::string(fault.order) + " " + moment.when);
  }
  std::optional<ScanRecord> end;
  if (auto record = service.submit(moment.step)) {
    end = service.end_of(record->id);
    if (!end) {
      cell.outcome = "HANGS";
      cell.bad.push_back("the scan does not end");
      machine.ask("clear " + std::string(fault.order).substr(0, std::string(fault.order).find(' ')));
      return cell;
    }
    const ScanProgress& p = end->progress;
    cell.outcome = to_string(end->state);
    cell.reason = end->reason;
    if (end->state == ScanState::done) {
      cell.reason = warnings_of(*end);
      if (p.frames_lost > 0) cell.reason += std::to_string(p.frames_lost) + " frames lost ";
      if (p.stale_frames > 0 && !moment.step) cell.reason += std::to_string(p.stale_frames) + " frames stale";
      if (!cell.reason.empty()) cell.outcome = "continued";
    }
  } else {
    cell.outcome = "refused";
    cell.reason = record.error().detail;
  }
  const bool over = cell.outcome == "done" || cell.outcome == "continued";
  judge_safety(machine, fault, service.end_ns(), cell);

  const bool named = contains_any(cell.reason, fault.names);
  cell.named = named ? "yes" : "-";
  if (!named && fault.known != FaultCase::Known::no && moment.machine_in_use) {
    const std::string at = moment.name;
    const bool healed = fault.homing_heals && (at == "preparing: warning" || at == "preparing: homing");
    // What came and went while nothing ran leaves a machine that is fit to scan.
    const bool must = !over || (fault.known == FaultCase::Known::named && !idle && !healed);
    if (must) {
      cell.named = "no";
      cell.bad.push_back("the cause is not named: " + (cell.reason.empty() ? "(no word)" : cell.reason));
    }
  }
  if (!moment.machine_in_use && !over && cell.outcome != "cancelled")
    cell.bad.push_back("a scan that no longer needs the machine failed: " + cell.reason);
  if (fault.never_continues && moment.machine_in_use && !idle && over) cell.bad.push_back("it continued by itself");
  if (end && moment.profiles_taken) {
    if (const std::string wrong = fault_of_log(end->folder.parent_path() / "profiles.log"); !wrong.empty())
      cell.bad.push_back("profiles were lost: " + wrong);
  }
  if (const json now = machine.state(); service.end_ns() - now["struck_ns"].get<std::int64_t>() > kLongest_ns)
    cell.bad.push_back("the scan took longer than 90 s of device time to end");
  judge_recovery(machine, service, fault, cell);
  return cell;
}

}  // namespace celadon::testing
