#pragma once
// What is kept of a scan while it measures: its log and, if asked for, its frames.

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/recording.h"
#include "daemon/profile_log.h"
#include "daemon/scan_job.h"
#include "daemon/scan_preparation.h"

namespace celadon {

/// As the controller says; of a recording, which does not name it, as the calibration does.
std::string machine_of(const ScanEquipment& equipment);
/// Whether controller or camera is a virtual one.
bool is_simulated(const ScanEquipment& equipment);

/// Where the frames of this scan are kept; nothing unless that was asked for.
tl::expected<std::unique_ptr<RecordingWriter>, ScanStop> open_recording(const ScanEquipment& equipment,
                                                                        const ScanTask& task);
/// Its log with the header written. Errors: the disk has less room than the scan will need; the file cannot be made.
/// @param stops  of head and lift
tl::expected<std::unique_ptr<ProfileLogWriter>, ScanStop> open_log(const ScanEquipment& equipment, const ScanTask& task,
                                                                   const ScanPreparation& seen,
                                                                   const std::vector<int>& lasers, std::size_t stops);
/// The finished log of samples with colours; nullptr where they have none.
tl::expected<std::unique_ptr<ProfileLogReader>, ScanStop> coloured_log(const ScanEquipment& equipment,
                                                                       const ScanTask& task);

}  // namespace celadon
