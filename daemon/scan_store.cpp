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

tl::expected<ScanRecord, std::string> parse_record(const std::string& text) {
  try {
    const auto json = nlohmann::json::parse(text);
    if (json.at("version").get<int>() != 1) return tl::make_unexpected("its version is not 1");
    ScanRecord record;
    record.id = json.at("id").get<std::uint64_t>();
    const auto state = scan_state_from(json.at("state").get<std::string>());
    if (!state) return tl::make_unexpected("its state is not known");
    record.state = *state;
    record.failure = scan_failure_from(json.value("failure", "")).value_or(ScanFailure::device);
    auto request = scan_request_from_json(json.at("request"));
    if (!request) return tl::make_unexpected(request.error().detail);
    record.request = *request;
    record.requested_by = json.at("requested_by").get<std::string>();
    record.reason = json.at("reason").get<std::string>();
    record.created = json.at("created").get<std::string>();
    record.simulated = json.at("simulated").get<bool>();
    record.files = json.at("files").get<std::vector<std::string>>();
    if (json.contains("checks")) record.checks = self_checks_from_json(json["checks"]);
    record.progress.samples = json.at("progress").at("samples").get<std::uint64_t>();
    record.progress.frames = json.at("progress").at("frames").get<int>();
    record.progress.fraction = json.at("progress").at("fraction").get<double>();
    return record;
  } catch (const std::exception& e) {
    return tl::make_unexpected(std::string(e.what()));
  }
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
  fs::create_directories(folder / "scans", code);
  if (code) return refused(code.message() + "; name a folder that may be written with --store.");
  ScanStore store(folder);
  store.lock_ = ::open((folder / "lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (store.lock_ < 0) return refused(std::strerror(errno) + std::string("; check the permissions of the folder."));
  if (::flock(store.lock_, LOCK_EX | LOCK_NB) != 0) {
    return refused("another celadond holds it; stop that one or name another folder with --store.");
  }
  if (const auto text = read_text(folder / "last-id")) store.last_id_ = number(*text).value_or(0);
  for (const auto& entry : fs::directory_iterator(folder / "scans", code)) {
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
  char name[24];
  std::snprintf(name, sizeof name, "%06llu", static_cast<unsigned long long>(id));
  return folder_ / "scans" / name;
}

std::vector<ScanRecord> ScanStore::load(std::vector<std::string>& problems) {
  std::vector<ScanRecord> records;
  std::error_code code;
  for (const auto& entry : fs::directory_iterator(folder_ / "scans", code)) {
    const auto id = number(entry.path().filename().string());
    const auto text = read_text(entry.path() / "scan.json");
    if (!id || !text) {
      problems.push_back(entry.path().string() + " holds no scan.json; it is left alone.");
      continue;
    }
    auto record = parse_record(*text);
    if (!record || record->id != *id) {
      problems.push_back((entry.path() / "scan.json").string() + " cannot be read (" +
                         (record ? "it is of scan " + std::to_string(record->id) : record.error()) +
                         "); the scan is left alone.");
      continue;
    }
    record->folder = results_folder(*id);
    if (!is_final(record->state)) {
      record->state = ScanState::interrupted;
      record->reason = interruption(log_file(*id));
      if (auto saved = save(*record); !saved) problems.push_back(saved.error().message);
    }
    records.push_back(std::move(*record));
  }
  std::sort(records.begin(), records.end(), [](const ScanRecord& a, const ScanRecord& b) { return a.id < b.id; });
  return records;
}

tl::expected<std::uint64_t, StoreError> ScanStore::new_scan() {
  const std::uint64_t id = last_id_ + 1;
  // The number is spent before it is used: a folder that is removed later does not free it.
  if (auto written = write_file_atomically(folder_ / "last-id", std::to_string(id) + "\n"); !written) {
    return tl::make_unexpected(StoreError{written.error().message});
  }
  last_id_ = id;
  std::error_code code;
  fs::create_directory(scan_folder(id), code);
  if (code) {
    return tl::make_unexpected(StoreError{"Creating " + scan_folder(id).string() + " failed: " + code.message() +
                                          "; check free space and permissions of the store."});
  }
  return id;
}

tl::expected<void, StoreError> ScanStore::save(const ScanRecord& record) {
  nlohmann::json json = to_json(record);
  json["version"] = 1;
  json.erase("folder");  // follows from the place of the file
  auto written = write_file_atomically(scan_folder(record.id) / "scan.json", json.dump(2) + "\n");
  if (!written) return tl::make_unexpected(StoreError{written.error().message});
  return {};
}

}  // namespace celadon
