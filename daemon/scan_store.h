#pragma once
// The folder of all scans and calibrations. Layout: RESULTS.md.

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/scan_service.h"

namespace celadon {

struct StoreError {
  std::string message;
};  ///< one sentence with path, cause and remedy

/// Held by one daemon at a time. Not thread-safe.
class ScanStore {
 public:
  /// Creates the folder if needed and locks it; refuses one that another daemon holds.
  static tl::expected<ScanStore, StoreError> open(const std::filesystem::path& folder);
  ScanStore(ScanStore&& other) noexcept;
  ScanStore& operator=(ScanStore&&) = delete;
  ~ScanStore();

  /// All scans, by rising number. Scans that were under way when a daemon ended become `interrupted`, with what their
  /// log holds, and are saved so. Records that cannot be read are left alone and named in `problems`.
  std::vector<ScanRecord> load(std::vector<std::string>& problems);
  /// All calibrations, likewise.
  std::vector<CalibrationRecord> load_calibrations(std::vector<std::string>& problems);

  /// A number that no job of this store ever had, and the folder for it.
  tl::expected<std::uint64_t, StoreError> new_scan();
  tl::expected<std::uint64_t, StoreError> new_calibration();
  /// Replaces scan.json.
  tl::expected<void, StoreError> save(const ScanRecord& record);
  /// Replaces calibration.json.
  tl::expected<void, StoreError> save(const CalibrationRecord& record);

  std::filesystem::path scan_folder(std::uint64_t id) const;
  std::filesystem::path calibration_folder(std::uint64_t id) const;
  std::filesystem::path log_file(std::uint64_t id) const { return scan_folder(id) / "profiles.log"; }
  std::filesystem::path results_folder(std::uint64_t id) const { return scan_folder(id) / "results"; }

 private:
  explicit ScanStore(std::filesystem::path folder) : folder_(std::move(folder)) {}
  tl::expected<std::uint64_t, StoreError> new_job(const std::function<std::filesystem::path(std::uint64_t)>& folder_of);
  std::filesystem::path folder_;
  int lock_ = -1;
  std::uint64_t last_id_ = 0;
};

}  // namespace celadon
