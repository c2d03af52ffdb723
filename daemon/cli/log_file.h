#pragma once
// The profile log of a scan as samples of a fit.

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include <tl/expected.hpp>

#include "daemon/files/cloud_files.h"
#include "daemon/profile_log.h"

namespace celadon::cli {

/// The file begins as a profile log does.
bool is_profile_log(const std::filesystem::path& file);

/// Every profile as the object lay and stood while it was measured: poses and lift heights of the log are undone, so
/// that profiles of several fit together. Columns are cylindrical. A log that a killed daemon left is read as far as it
/// goes.
class LogFile final : public CloudFile {
 public:
  /// Of `options` only X_SF counts. Errors: a sentence that names the file.
  static tl::expected<std::unique_ptr<LogFile>, std::string> open(const std::filesystem::path& file,
                                                                  const CloudOptions& options);
  const LogHeader& header() const { return reader_->header(); }
  /// After a pass: how the scan ended, if not in order; empty: it did.
  std::string ending() const;

  void rewind() override;
  const Profile* next() override;
  std::uint64_t points() const override { return points_; }
  std::uint64_t skipped() const override { return 0; }
  const std::string& error() const override { return error_.empty() ? reader_->error() : error_; }
  CloudColumns columns() const override { return CloudColumns::cylindrical; }

 private:
  LogFile(std::unique_ptr<ProfileLogReader> reader, const Eigen::Isometry3d& X_LS)
      : reader_(std::move(reader)), X_LS_(X_LS) {}
  std::unique_ptr<ProfileLogReader> reader_;
  Eigen::Isometry3d X_LS_;
  std::map<std::uint16_t, Eigen::Isometry3d> X_PS_;  ///< of the poses so far
  std::uint64_t points_ = 0;                         ///< so far
  std::string error_;
  Profile moved_;
};

}  // namespace celadon::cli
