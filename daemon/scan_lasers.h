#pragma once
// The turns of a scan: with which lasers, what was seen of the object before each, and one after the other, at each
// stop of the axes beside the table. Why not all in one turn: README.md, "Several lasers".

#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/frame_feed.h"
#include "daemon/scan_capture.h"
#include "daemon/scan_job.h"
#include "daemon/scan_preparation.h"

namespace celadon {

/// The lasers that a machine or a recording has; of a recording that does not say which, the first that is calibrated.
/// @param device  nullptr with a recording
std::vector<int> lasers_present(const ScannerDevice* device, const FrameSource& camera, const Calibration& calibration);

/// The lasers that a scan uses, in the order of their turns: those asked for, else all that are calibrated and present.
/// @returns one sentence with the laser and the remedy where one asked for is not calibrated or not there
tl::expected<std::vector<int>, std::string> lasers_of(const ScanRequest& request, const Calibration& calibration,
                                                      std::span<const int> present);

/// How a laser's line lies in the picture, by its plane.
LineAlong along_of(int laser, const Calibration& calibration);

/// The exposures of one laser's turns: one plan; two where a second turn sees what the first does not. No plan: one
/// turn as the camera stands.
struct LaserExposures {
  int laser = 0;
  std::vector<ExposurePlan> plans;
};
/// The turns to come, before anything moved or was seen: with each laser and exposure at the first stop, then at the
/// next.
/// @pre axes off 0 are calibrated
std::vector<LaserTurn> turns_with(std::span<const LaserExposures> lasers, std::span<const AxisStop> stops,
                                  const Calibration& calibration, const ScanVolume& volume);
/// The turns of the stop that a turn belongs to.
std::span<LaserTurn> turns_at(std::size_t stop_number, std::span<LaserTurn> turns);
/// Says where the axes came to rest for these turns of one stop.
void stand_at(const AxisStop& stop, std::span<LaserTurn> turns, const ScanEquipment& equipment);

/// Looks at the object as it stands with the laser of each of these turns of one stop, the first one last, and fills
/// their `seen`. Leaves the first laser on and the others off.
/// @returns what they see together: the heights of all, the samples of a frame of each, the warnings of the first
tl::expected<ScanPreparation, ScanStop> look_with_each(const ScanEquipment& equipment, FrameFeed& feed,
                                                       std::span<LaserTurn> turns);

/// One turn after the other, each as the request wants it or as the recording holds it. Between two turns all lasers
/// are off, seen dark by the camera, the axes move to the next stop, and the background is taken anew.
/// @returns the sum of all turns
/// @pre look_with_each() was done at the first stop; tools.turn and tools.so_far are not looked at
tl::expected<CaptureResult, ScanStop> turn_with_each(const CaptureTools& tools, std::span<LaserTurn> turns);

/// The turn that is or was the last whose laser shone.
const LaserTurn& turn_of(const FrameFeed& feed, std::span<const LaserTurn> turns);

}  // namespace celadon
