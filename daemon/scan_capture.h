#pragma once
// Move, frame, line, profile, log, accumulate: the part of a scan during which the table turns, once for each laser
// and stop of the other axes.

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/axis_stop.h"
#include "acquisition/laser_line.h"
#include "daemon/checks/profile_jitter.h"
#include "daemon/datum_watch.h"
#include "daemon/exposure_plan.h"
#include "daemon/frame_feed.h"
#include "daemon/laser_agreement.h"
#include "daemon/profile_log.h"
#include "daemon/report.h"
#include "daemon/room_light_watch.h"
#include "daemon/scan_job.h"
#include "daemon/scan_preparation.h"
#include "daemon/view_watch.h"
#include "fitting/moment_grid.h"

namespace celadon {

/// One laser's turn at one stop of the axes beside the table, one of two if it takes two exposures: what its pixels
/// mean, and what was seen of the object before it.
struct LaserTurn {
  int laser = 0;
  std::size_t stop_number = 0;  ///< of the scan's stops
  AxisStop stop;                ///< where the axes shall stand; once they do, where they stand
  Triangulator triangulator;
  ExposurePlan plan = {};        ///< of this turn
  ExposurePlan other_plan = {};  ///< of the turn that sees the same with another exposure; empty: there is none
  ScanPreparation seen = {};
};

/// What the turns of a scan count on from one to the next.
struct CaptureSoFar {
  int turn = 0, turns = 1;  ///< the present one, from 0; of the whole scan
  std::uint32_t profiles = 0;
  std::uint64_t ambiguous = 0;
  std::chrono::steady_clock::time_point start = std::chrono::steady_clock::now();
};

/// What the capture stages work with.
struct CaptureTools {
  const ScanEquipment& equipment;
  const ScanRequest& request;
  FrameFeed& feed;
  ProfileLogWriter& log;
  MomentGrid& sums;
  FirstLook& look;
  LaserAgreement& agreement;
  ProfileJitter& jitter;
  ViewWatch& view;
  RoomLightWatch& room;
  DatumWatch& datum;
  ScanObserver& observer;
  const LaserTurn* turn = nullptr;  ///< the present one
  CaptureSoFar* so_far = nullptr;
};

struct CaptureResult {
  ScanCounters counters;                   ///< of all turns so far
  std::vector<LaserShare> lasers;          ///< of this turn
  std::optional<ClosureError> closure_mm;  ///< of this turn; of several the worst
  std::vector<std::string> warnings;
};

/// One turn and a little more at constant speed, a frame where it falls.
tl::expected<CaptureResult, ScanStop> sweep(const CaptureTools& tools);
/// One turn and a little more in steps, one frame at rest after each, always approached from the same side. Where the
/// room's light changed, the background is taken anew.
tl::expected<CaptureResult, ScanStop> step_around(const CaptureTools& tools);

/// The laser's turn that a recording holds, each frame at the angle noted with it.
tl::expected<CaptureResult, ScanStop> replay(const CaptureTools& tools);

/// How long a turn of a sweep takes, by camera and table.
double seconds_of_sweep(const ScanEquipment& equipment, int profiles);

/// Whether the table can make the turn that the request wants from where it stands.
bool turn_fits_travel(const CaptureTools& tools);

}  // namespace celadon
