#pragma once
// The samples that `celadon fit` reads: one file or two poses of an object, in the frame they are fitted in.

#include <Eigen/Geometry>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/cli/log_file.h"
#include "daemon/files/cloud_files.h"
#include "fitting/joint_pose.h"
#include "fitting/local_frame.h"
#include "fitting/moved_stream.h"
#include "fitting/range_function.h"
#include "fitting/turned_over.h"

namespace celadon::cli {

/// The file's z axis, as far as the samples can tell: within three standard deviations, and within what the shape that
/// gave the axis leaves unexplained.
bool on_z(const LocalFrame& own);
/// Why an axis that nobody asked for is not taken; empty: it is.
std::string reason_for_z(const LocalFrame& own);

class FitInput {
 public:
  /// Errors: sentences that name the file.
  static tl::expected<FitInput, std::string> open(const std::filesystem::path& file, const CloudOptions& options);

  ProfileStream& samples() { return *joined_; }
  /// The same in parts that can be read side by side.
  ProfileParts parts() const { return *parts_; }
  /// The first file, if it is the log of a scan.
  const LogFile* log() const;
  CloudColumns columns() const { return files_.front()->columns(); }
  /// The samples' own frame, from an even sample.
  tl::expected<LocalFrame, std::string> own_frame();
  /// From now on in the frame L of the first file's S.
  tl::expected<void, std::string> place(const Eigen::Isometry3d& X_SL);
  /// The same object upside down joins, as `wall` (in S) lets it be found.
  /// @param about_own_axis it may stand anywhere: its own axis is laid on that of S first
  tl::expected<PoseAlignment, std::string> add_turned_over(const std::filesystem::path& file, const RangeFunction& wall,
                                                           const std::optional<LocalFrame>& about_own_axis);

  /// The same object, raised by a lift along the axis when the file was made, joins.
  tl::expected<void, std::string> add_raised(const std::filesystem::path& file, double lift_mm);
  /// The second file's pose and the surface of both, refined together. @pre there is a second file, `wall` (in S) was
  /// fitted here
  tl::expected<JointPose, std::string> refine_second(const RangeFunction& wall, PoseFreedom freedom, double noise_mm);

  /// What the last pass met; empty: nothing.
  std::string error() const;
  std::uint64_t skipped() const;

 private:
  FitInput() = default;
  tl::expected<void, std::string> reopen();

  std::filesystem::path first_file_, second_file_;
  CloudOptions options_;
  std::optional<Eigen::Isometry3d> X_SL_;  // nullopt: as the file lies
  Eigen::Isometry3d X_S2_ = Eigen::Isometry3d::Identity();
  std::vector<std::unique_ptr<CloudFile>> files_;  // parts of the first file, then of the second
  std::size_t first_parts_ = 0;
  std::unique_ptr<std::vector<ProfileStream*>> parts_;
  std::unique_ptr<ProfileStream> joined_;
};

}  // namespace celadon::cli
