#pragma once
// Move, frame, line, profile, log, accumulate: the part of a scan during which the table turns.

#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/laser_line.h"
#include "daemon/frame_feed.h"
#include "daemon/profile_log.h"
#include "daemon/report.h"
#include "daemon/scan_job.h"
#include "daemon/scan_preparation.h"
#include "fitting/moment_grid.h"

namespace celadon {

/// What the capture stages work with.
struct CaptureTools {
  const ScanEquipment& equipment;
  const ScanRequest& request;
  FrameFeed& feed;
  LaserLineExtractor& extractor;
  const Triangulator& triangulator;
  const ScanPreparation& preparation;
  ProfileLogWriter& log;
  MomentGrid& sums;
  FirstLook& look;
  ScanObserver& observer;
};

struct CaptureResult {
  ScanCounters counters;
  std::optional<ClosureError> closure_mm;
  std::vector<std::string> warnings;
};

/// One turn and a little more at constant speed, a frame where it falls.
tl::expected<CaptureResult, ScanStop> sweep(const CaptureTools& tools);
/// One turn and a little more in steps, one frame at rest after each, always approached from the same side.
tl::expected<CaptureResult, ScanStop> step_around(const CaptureTools& tools);

/// The turn that a recording holds, each frame at the angle noted with it.
tl::expected<CaptureResult, ScanStop> replay(const CaptureTools& tools);

}  // namespace celadon
