#pragma once
// What every job of the machine's owner has, whatever it does: a scan, a calibration.

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "daemon/scan_state.h"

namespace celadon {

struct JobRecord {
  std::uint64_t id = 0;      ///< 1, 2, ... one series for all jobs of a store, never reused
  std::string requested_by;  ///< "button", "api"
  ScanState state = ScanState::queued;
  ScanFailure failure = ScanFailure::device;  ///< of failed
  std::string reason;                         ///< of failed, cancelled, interrupted: one sentence with the remedy
  std::string created;                        ///< ISO 8601 UTC
  bool simulated = false;
  std::filesystem::path folder;    ///< of the results
  std::vector<std::string> files;  ///< names in `folder` once done
};

/// The fields of openapi.yaml that all jobs have.
nlohmann::json job_json(const JobRecord& job);

}  // namespace celadon
