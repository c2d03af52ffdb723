#pragma once
// The lasers of a scan: which ones, what was seen of the object with each, and a full turn with each, one after the
// other. Why not all in one turn: README.md, "Several lasers".

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

/// The turns to come, before anything was seen.
std::vector<LaserTurn> turns_with(std::span<const int> lasers, const Calibration& calibration,
                                  const ScanVolume& volume);

/// Looks at the object as it stands with each laser, the first one last, and fills `seen` of each turn. Leaves the
/// first laser on and the others off.
/// @returns what they see together: the heights of all, the samples of a frame of each, the warnings of the first
tl::expected<ScanPreparation, ScanStop> look_with_each(const ScanEquipment& equipment, FrameFeed& feed,
                                                       std::span<LaserTurn> turns);

/// One turn after the other, each as the request wants it or as the recording holds it. Between two turns all lasers
/// are off, seen dark by the camera, and the background is taken anew. @returns the sum of all turns
/// @pre look_with_each() was done; tools.turn and tools.so_far are not looked at
tl::expected<CaptureResult, ScanStop> turn_with_each(const CaptureTools& tools, std::span<LaserTurn> turns);

/// The turn of the laser that is or was the last to shine.
const LaserTurn& turn_of(int laser, std::span<const LaserTurn> turns);

}  // namespace celadon
