#include "daemon/scan_store.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <utility>

#include <nlohmann/json.hpp>

#include "daemon/files/atomic_file.h"
#include "daemon/profile_log.h"

namespace celadon {
namespace {

namespace fs = std::filesystem;

std::optional<std::string> read_text(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) return std::nullopt;
  return std::string(std::istreambuf_iterator<char>(in), {});
}

std::optional<std::uint64_t> number(std::string text) {
  while (!text.empty() && text.back() == '\n') text.pop_back();
  std::uint64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || text.empty()) return std::nullopt;
  return value;
}

/// What scans and calibrations have in common. @throws nlohmann::json::exception, and a text for what is not known
void read_job(const nlohmann::json& json, JobRecord& job) {
  if (json.at("version").get<int>() != 1) throw std::runtime_error("its version is not 1");
  job.id = json.at("id").get<std::uint64_t>();
  const auto state = scan_state_from(json.at("state").get<std::string>());
  if (!state) throw std::runtime_error("its state is not known");
  job.state = *state;
  job.failure = scan_failure_from(json.value("failure", "")).value_or(ScanFailure::device);
  job.requested_by = json.at("requested_by").get<std::string>();
  job.reason = json.at("reason").get<std::string>();
  job.created = json.at("created").get<std::string>();
  job.simulated = json.at("simulated").get<bool>();
  job.files = json.at("files").get<std::vector<std::string>>();
}

void read_record(const nlohmann::json& json, ScanRecord& record) {
  read_job(json, record);
  auto request = scan_request_from_json(json.at("request"));
  if (!request) throw std::runtime_error(request.error().detail);
  record.request = *request;
  if (json.contains("checks")) record.checks = self_checks_from_json(json["checks"]);
  record.progress.samples = json.at("progress").at("samples").get<std::uint64_t>();
  record.progress.frames = json.at("progress").at("frames").get<int>();
  record.progress.fraction = json.at("progress").at("fraction").get<double>();
}

void read_record(const nlohmann::json& json, CalibrationRecord& record) {
  read_job(json, record);
  auto request = calibration_request_from_json(json.at("request"));
  if (!request) throw std::runtime_error(request.error().detail);
  record.request = *request;
  read_calibration_findings(json, record);
}

/// Records of the jobs in a folder, by rising number.
template <class Record>
std::vector<Record> read_records(const fs::path& folder, const std::string& name, std::vector<std::string>& problems) {
  std::vector<Record> records;
  std::error_code code;
  for (const auto& entry : fs::directory_iterator(folder, code)) {
    const auto id = number(entry.path().filename().string());
    const fs::path file = entry.path() / name;
    const auto text = read_text(file);
    if (!id || !text) {
      problems.push_back(entry.path().string() + " holds no " + name + "; it is left alone.");
      continue;
    }
    try {
      Record record;
      read_record(nlohmann::json::parse(*text), record);
      if (record.id != *id) throw std::runtime_error("it is of number " + std::to_string(record.id));
      records.push_back(std::move(record));
    } catch (const std::exception& e) {
      problems.push_back(file.string() + " cannot be read (" + e.what() + "); it is left alone.");
    }
  }
  std::sort(records.begin(), records.end(), [](const Record& a, const Record& b) { return a.id < b.id; });
  return records;
}

tl::expected<void, StoreError> write_record(nlohmann::json json, const fs::path& file) {
  json["version"] = 1;
  json.erase("folder");  // follows from the place of the file
  auto written = write_file_atomically(file, json.dump(2) + "\n");
  if (!written) return tl::make_unexpected(StoreError{written.error().message});
  return {};
}

fs::path numbered(const fs::path& folder, std::uint64_t id) {
  char name[24];
  std::snprintf(name, sizeof name, "%06llu", static_cast<unsigned long long>(id));
  return folder / name;
}

/// What an interrupted scan left.
std::string interruption(const fs::path& log_file) {
  const std::string again = "; start a new scan.";
  std::error_code code;
  if (!fs::exists(log_file, code)) return "The daemon ended before the first profile" + again;
  auto log = ProfileLogReader::open(log_file);
  if (!log) return "The daemon ended during the scan. " + log.error().message;
  std::uint64_t profiles = 0, samples = 0;
  while (const Profile* p = (*log)->next()) {
    ++profiles;
    samples += p->size();
  }
  std::string text = "The daemon ended during the scan; its log holds " + std::to_string(profiles) + " profiles with " +
                     std::to_string(samples) + " samples";
  if ((*log)->torn_bytes() > 0) text += " and " + std::to_string((*log)->torn_bytes()) + " torn bytes at the end";
  if (profiles > 0) text += "; celadon fit " + log_file.string() + " makes of it what can be made";
  return text + again;
}

}  // namespace

tl::expected<ScanStore, StoreError> ScanStore::open(const fs::path& folder) {
  const auto refused = [&](const std::string& why) {
    return tl::make_unexpected(StoreError{"The store " + folder.string() + " cannot be used: " + why});
  };
  std::error_code code;
  for (const char* jobs : {"scans", "calibrations"}) {
    if (!code) fs::create_directories(folder / jobs, code);
  }
  if (code) return refused(code.message() + "; name a folder that may be written with --store.");
  ScanStore store(folder);
  store.lock_ = ::open((folder / "lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (store.lock_ < 0) return refused(std::strerror(errno) + std::string("; check the permissions of the folder."));
  if (::flock(store.lock_, LOCK_EX | LOCK_NB) != 0) {
    return refused("another celadond holds it; stop that one or name another folder with --store.");
  }
  if (const auto text = read_text(folder / "last-id")) store.last_id_ = number(*text).value_or(0);
  for (const char* jobs : {"scans", "calibrations"}) {
    for (const auto& entry : fs::directory_iterator(folder / jobs, code))
      store.last_id_ = std::max(store.last_id_, number(entry.path().filename().string()).value_or(0));
  }
  return store;
}

ScanStore::ScanStore(ScanStore&& other) noexcept
    : folder_(std::move(other.folder_)), lock_(std::exchange(other.lock_, -1)), last_id_(other.last_id_) {}

ScanStore::~ScanStore() {
  if (lock_ >= 0) ::close(lock_);
}

fs::path ScanStore::scan_folder(std::uint64_t id) const {
  return numbered(folder_ / "scans", id);
}

fs::path ScanStore::calibration_folder(std::uint64_t id) const {
  return numbered(folder_ / "calibrations", id);
}

std::vector<ScanRecord> ScanStore::load(std::vector<std::string>& problems) {
  auto records = read_records<ScanRecord>(folder_ / "scans", "scan.json", problems);
  for (ScanRecord& record : records) {
    record.folder = results_folder(record.id);
    if (is_final(record.state)) continue;
    record.state = ScanState::interrupted;
    record.reason = interruption(log_file(record.id));
    if (auto saved = save(record); !saved) problems.push_back(saved.error().message);
  }
  return records;
}

std::vector<CalibrationRecord> ScanStore::load_calibrations(std::vector<std::string>& problems) {
  auto records = read_records<CalibrationRecord>(folder_ / "calibrations", "calibration.json", problems);
  for (CalibrationRecord& record : records) {
    record.folder = calibration_folder(record.id);
    if (is_final(record.state)) continue;
    // While it is written there may be the old file or the new one, each whole.
    record.reason = record.state == ScanState::exporting
                        ? "The daemon ended while the calibration was written; the date of the machine's calibration "
                          "tells whether it is in use."
                        : "The daemon ended during the calibration; nothing was changed, start it again.";
    record.state = ScanState::interrupted;
    if (auto saved = save(record); !saved) problems.push_back(saved.error().message);
  }
  return records;
}

tl::expected<std::uint64_t, StoreError> ScanStore::new_scan() {
  return new_job([this](std::uint64_t id) { return scan_folder(id); });
}

tl::expected<std::uint64_t, StoreError> ScanStore::new_calibration() {
  return new_job([this](std::uint64_t id) { return calibration_folder(id); });
}

tl::expected<std::uint64_t, StoreError> ScanStore::new_job(const std::function<fs::path(std::uint64_t)>& folder_of) {
  const std::uint64_t id = last_id_ + 1;
  // The number is spent before it is used: a folder that is removed later does not free it.
  if (auto written = write_file_atomically(folder_ / "last-id", std::to_string(id) + "\n"); !written) {
    return tl::make_unexpected(StoreError{written.error().message});
  }
  last_id_ = id;
  std::error_code code;
  fs::create_directory(folder_of(id), code);
  if (code) {
    return tl::make_unexpected(StoreError{"Creating " + folder_of(id).string() + " failed: " + code.message() +
                                          "; check free space and permissions of the store."});
  }
  return id;
}

tl::expected<void, StoreError> ScanStore::save(const ScanRecord& record) {
  return write_record(to_json(record), scan_folder(record.id) / "scan.json");
}

tl::expected<void, StoreError> ScanStore::save(const CalibrationRecord& record) {
  return write_record(to_json(record), calibration_folder(record.id) / "calibration.json");
}

}  // namespace celadon
