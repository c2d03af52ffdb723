#pragma once
// Before the table turns: fit to scan, homed, exposure set, the background known, the laser warm and its line seen.

#include <cstdint>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/axis_stop.h"
#include "acquisition/laser_line.h"
#include "daemon/backgrounds.h"
#include "daemon/exposure_plan.h"
#include "daemon/frame_feed.h"
#include "daemon/scan_job.h"

namespace celadon {

struct LineBrightness {
  int lines = 0, saturated = 0;  ///< rows
  double amplitude = 0;          ///< mean over the rows with a line, grey levels
};
LineBrightness brightness_of(const std::vector<LineRow>& rows);

/// What was learned before the scan.
struct ScanPreparation {
  Backgrounds backgrounds;             ///< means of frames with the laser off, same mode and stride
  double background_at_rad = 0;        ///< encoder's angle of the backgrounds
  std::int64_t exposure_ns = 0;        ///< at which the object was looked at
  double z_low_mm = 0, z_high_mm = 0;  ///< of the line on the object as it stands
  std::size_t samples = 0;             ///< of one profile
  LineBrightness line;                 ///< of the line on the object as it stands
  std::vector<std::string> warnings;
};

/// Puts the exposure that was found back on every way out, so that a scan leaves nothing to the next one.
class ExposureOnExit {
 public:
  explicit ExposureOnExit(FrameSource& camera) : camera_(camera) {}
  ~ExposureOnExit() { camera_.restore_exposure(); }
  ExposureOnExit(const ExposureOnExit&) = delete;
  ExposureOnExit& operator=(const ExposureOnExit&) = delete;

 private:
  FrameSource& camera_;
};

/// Of a machine: checks interlock and faults, lasers off, warns for two seconds if the start comes from afar (the lamp
/// is the observer's), homes if needed, sets the exposure.
tl::expected<void, ScanStop> make_device_ready(const ScanEquipment& equipment, const ScanTask& task,
                                               ScanObserver& observer);
/// Mean of a few frames that were exposed from now on. @pre the laser is off
tl::expected<std::vector<std::uint8_t>, ScanStop> dark_background(FrameFeed& feed, Clock& clock);
/// Backgrounds with the laser off, by a plan those of a quick turn, then the laser on until its line is steady. Leaves
/// the laser on.
/// @param other_plan  of the turn that sees the same: the line is looked for where both expose for the shortest time
tl::expected<ScanPreparation, ScanStop> look_at_object(const ScanEquipment& equipment, FrameFeed& feed,
                                                       const Triangulator& triangulator, const ExposurePlan& plan = {},
                                                       const ExposurePlan& other_plan = {});

/// Which of the looks with a laser at a stop: those that fixed what is worked on, or the ones that its own turn
/// followed.
enum class RecordedLook { before_all_turns, before_its_turn };
/// The same of a recording, which it starts from its first frame: background from the laser's frames with the laser off
/// (none: empty), the object from its last look, else from the first frame of its turn.
tl::expected<ScanPreparation, ScanStop> look_at_recording(const ScanEquipment& equipment,
                                                          const Triangulator& triangulator, int laser,
                                                          const AxisStop& stop, RecordedLook which);
/// Whether a recorded frame belongs to a laser's turn at a stop; in a recording that does not say, each does.
bool is_of_turn(const FrameSource& camera, const FrameInfo& frame, int laser, const AxisStop& stop);

}  // namespace celadon
