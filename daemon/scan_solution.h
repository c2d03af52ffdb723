#pragma once
// From the samples of a scan to the body that they show.

#include <filesystem>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/body_fit.h"
#include "daemon/profile_log.h"
#include "daemon/results.h"
#include "daemon/scan_job.h"
#include "fitting/first_look.h"
#include "fitting/moment_grid.h"

namespace celadon {

RangeFitOptions fit_options(const ScanRequest& request, const Calibration& calibration);

/// The log in parts that are read at the same time; always as many, so that results do not depend on the machine.
class LogParts {
 public:
  static tl::expected<LogParts, ScanStop> open(const std::filesystem::path& file, const ProfileLogWriter& log);
  ProfileParts streams() const { return streams_; }
  /// Of the first part that is damaged; empty: none is.
  std::string error() const {
    for (const auto& reader : readers_) {
      if (!reader->error().empty()) return reader->error();
    }
    return {};
  }

 private:
  std::vector<std::unique_ptr<ProfileLogReader>> readers_;
  std::vector<ProfileStream*> streams_;
};

struct FittedPiece {
  RangeFunction function;
  NurbsSurface surface;
};

/// A body whose errors may still be on their way.
struct SolvedBody {
  std::vector<FittedPiece> pieces;
  double noise_mm = 0;
  std::future<tl::expected<BodyFit, ResultError>> measured;
};

/// One wall from the sums and the first look that were gathered while the table turned, with one pass over the log; of
/// a part that is round about an axis of its own, about that one. Its errors are another pass, which reads the log:
/// that must outlive `measured`. Where too many samples lie outside the band that was fixed before the scan, sums and
/// look are made again from `file`.
tl::expected<SolvedBody, ScanStop> solve_wall(const std::filesystem::path& file, const RangeFitOptions& options,
                                              MomentGrid& sums, FirstLook& look, const LogParts& log,
                                              ResultNotes& notes);

/// What the samples show as the shape of that name, from the log alone: faces, shoulders, heads.
/// @param centre_z_mm  where spherical samples are about, if the scan's kinematics say so and the object holds it
tl::expected<SolvedBody, ScanStop> solve_shape(const std::string& name, const RangeFitOptions& options,
                                               const LogParts& log, std::optional<double> centre_z_mm,
                                               ResultNotes& notes);

}  // namespace celadon
