#pragma once
// Everything measured in one scan, appended while it is measured. Grammar and guarantees: PROFILE_LOG.md.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/angle_timeline.h"
#include "acquisition/axis_stop.h"
#include "daemon/log_records.h"
#include "daemon/scan_service.h"
#include "fitting/profile.h"

namespace celadon {

/// What the first record says of the scan.
struct LogHeader {
  std::string date;  ///< ISO 8601 UTC
  std::string machine, camera;
  bool simulated = false;
  ScanRequest request;
  std::string calibration;  ///< text of the calibration file
  /// In the order of their turns; empty: one, and the log, of version 1.0, does not say which.
  std::vector<int> lasers = {};
  bool colour = false;  ///< its profiles tell the colours of their samples; the log is then of version 1.3
};

/// Placement of the object: rigid transform of points of the object to the scanner frame.
struct LogPose {
  std::uint16_t pose = 0;
  Eigen::Isometry3d X_SP = Eigen::Isometry3d::Identity();
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();  ///< of (rotation vector, translation)
};

enum class FrameVerdict : std::uint16_t {
  profile = 0,
  stale = 1,
  corrupt = 2,
  outside_turn = 3,
  no_angle = 4,
  no_line = 5,
  unlit = 6
};

struct LogFrame {
  std::uint64_t sequence = 0;
  std::int64_t stamp_ns = 0, exposure_ns = 0;
  std::uint32_t lost_before = 0;
  FrameVerdict verdict = FrameVerdict::profile;
};

enum class LogOutcome : std::uint16_t { complete = 0, cancelled = 1, failed = 2 };

struct LogEnd {
  LogOutcome outcome = LogOutcome::complete;
  std::uint32_t profiles = 0;
  std::uint64_t samples = 0, frames = 0, lost = 0, stale = 0, corrupt = 0;
  std::string reason;
};

/// A profile in the log; overlap: measured a second time beyond the full turn, not part of the fit.
struct LoggedProfile {
  bool overlap = false;
  const Profile* profile = nullptr;  ///< valid until the next read
};

/// Where the axes beside the table stand for the profiles that follow.
struct LogStop {
  AxisStop stop;
};

using LogEntry = std::variant<LogPose, LoggedProfile, PositionSample, LogFrame, LogEnd, LogStop>;

/// Writes a log. Used from one thread. Profiles are handed to the kernel as they come (a killed daemon loses none);
/// the disk is synced every second and at the end.
class ProfileLogWriter {
 public:
  /// Creates the file; writes header and pose 0 (identity).
  static tl::expected<std::unique_ptr<ProfileLogWriter>, LogError> create(const std::filesystem::path& file,
                                                                          const LogHeader& header);

  tl::expected<void, LogError> append(const LogPose& pose);
  tl::expected<void, LogError> append(const Profile& profile, bool overlap = false);
  /// Kept in memory until the next profile or the end.
  void append(const PositionSample& sample);
  void append(const LogFrame& frame);
  /// Likewise; a stop that the profiles before had too is not written again.
  void append(const LogStop& stop);
  /// Writes the end record and starts its sync; profiles, samples and frame counts are filled in from what was
  /// appended.
  tl::expected<void, LogError> finish(LogOutcome outcome, const std::string& reason);
  /// Waits until all is on the disk.
  tl::expected<void, LogError> wait_synced() { return records_->wait_synced(); }

  /// Marks that divide the profiles so far into parts of about the same size: `parts` + 1 of them. @pre parts > 0
  std::vector<RecordMark> divide(int parts) const;

  /// Counted so far; outcome and reason empty.
  const LogEnd& counts() const { return counts_; }
  std::uint64_t bytes() const { return records_->bytes(); }

 private:
  explicit ProfileLogWriter(std::unique_ptr<RecordWriter> records) : records_(std::move(records)) {}
  std::unique_ptr<RecordWriter> records_;
  std::vector<std::uint8_t> payload_;
  std::vector<RecordMark> marks_;  ///< before every kProfilesPerMark-th profile
  LogEnd counts_;
  bool colour_ = false;
  AxisStop stop_;
  std::int64_t last_sync_ns_ = 0;
};

/// Reads a log as a stream of the profiles that belong to the fit, any number of times.
class ProfileLogReader final : public ProfileStream {
 public:
  static tl::expected<std::unique_ptr<ProfileLogReader>, LogError> open(const std::filesystem::path& file);
  /// Only the profiles between two marks of the writer's.
  static tl::expected<std::unique_ptr<ProfileLogReader>, LogError> open(const std::filesystem::path& file,
                                                                        const RecordMark& begin, const RecordMark& end);

  const LogHeader& header() const { return header_; }
  void rewind() override;
  const Profile* next() override;
  /// The next record of any known kind; nullopt at the end.
  std::optional<LogEntry> next_entry();

  /// Not empty after damage was met: file, offsets, remedy.
  const std::string& error() const;
  /// After a pass: the end record, if the log has one.
  const std::optional<LogEnd>& end() const { return end_; }
  /// After a pass: bytes of a torn tail that could not be used.
  std::uint64_t torn_bytes() const { return records_->torn_bytes(); }

 private:
  explicit ProfileLogReader(std::unique_ptr<RecordReader> records) : records_(std::move(records)) {}
  bool broken(const Record& record, const char* what);

  std::unique_ptr<RecordReader> records_;
  LogHeader header_;
  Profile profile_;
  std::optional<LogEnd> end_;
  std::string error_;
};

}  // namespace celadon
