#pragma once
// What the commands that end in a surface share: its files.

#include <chrono>
#include <filesystem>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>
#include <tl/expected.hpp>

#include "daemon/results.h"
#include "fitting/range_fit.h"

namespace celadon::cli {

class StopWatch {
 public:
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    const double seconds = std::chrono::duration<double>(now - began_).count();
    began_ = now;
    return seconds;
  }

 private:
  std::chrono::steady_clock::time_point began_ = std::chrono::steady_clock::now();
};

using OutputFiles = std::vector<std::pair<ResultFormat, std::filesystem::path>>;

/// Checked before hours of work, not after: endings and folders. The report comes last, it holds what the others found.
/// Errors: one sentence.
tl::expected<OutputFiles, std::string> output_files(const std::vector<std::string>& outputs, const std::string& report);
/// "'FILE' cannot be written: ..." where its folder is missing; empty: it is there.
std::string missing_folder(const std::string& output);

/// Writes them and prints the report: as one line of JSON or, after `title`, in words. `report` is asked for once the
/// other files have been written. @returns the exit code
int finish(std::span<const RangeFit> pieces, const OutputFiles& outputs, ResultNotes& notes,
           const ResultOptions& options, const std::function<nlohmann::ordered_json()>& report, StopWatch& watch,
           const std::string& title, bool json);

}  // namespace celadon::cli
