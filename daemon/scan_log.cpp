#include "daemon/scan_log.h"

#include <sys/statvfs.h>

#include <cstdio>
#include <filesystem>
#include <string>
#include <system_error>
#include <utility>

namespace celadon {
namespace {

constexpr double kBytesPerSample = 50, kBytesPerColour = 3;

tl::unexpected<ScanStop> not_kept(const std::string& reason) {
  return tl::make_unexpected(ScanStop{ScanState::failed, reason, false, false, ScanFailure::system});
}

/// Whether the samples of a scan have colours.
bool delivers_colours(const ScanEquipment& equipment, const ScanRequest& request) {
  return request.method != ScanMethod::stereo && equipment.camera.mode().colour.layout != ColourLayout::none;
}

}  // namespace

std::string machine_of(const ScanEquipment& equipment) {
  return equipment.device != nullptr ? equipment.device->identity().machine : equipment.calibration.machine;
}

bool is_simulated(const ScanEquipment& equipment) {
  return (equipment.device != nullptr && equipment.device->identity().simulated) || equipment.camera.mode().simulated;
}

tl::expected<std::unique_ptr<RecordingWriter>, ScanStop> open_recording(const ScanEquipment& equipment,
                                                                        const ScanTask& task) {
  if (task.recording_folder.empty() || task.request.method == ScanMethod::stereo || task.request.exposure_auto)
    return nullptr;
  std::error_code error;
  std::filesystem::create_directories(task.recording_folder, error);
  if (error) {
    return not_kept("The folder " + task.recording_folder.string() +
                    " for the frames cannot be made: " + error.message() + "; give another with --record.");
  }
  return std::make_unique<RecordingWriter>(
      task.recording_folder, equipment.camera.mode(),
      RecordedScan{task.date, task.request.mode == ScanMode::step ? "step" : "sweep", task.request.profiles});
}

tl::expected<std::unique_ptr<ProfileLogWriter>, ScanStop> open_log(const ScanEquipment& equipment, const ScanTask& task,
                                                                   const ScanPreparation& seen,
                                                                   const std::vector<int>& lasers, std::size_t stops) {
  const bool colour = delivers_colours(equipment, task.request);
  const double wanted = (kBytesPerSample + (colour ? kBytesPerColour : 0)) * static_cast<double>(seen.samples * stops) *
                        task.request.profiles * 1.1;
  struct statvfs disk {};
  if (::statvfs(task.log_file.parent_path().c_str(), &disk) == 0) {
    const double free = static_cast<double>(disk.f_bavail) * static_cast<double>(disk.f_frsize);
    if (free < wanted) {
      char text[256];
      std::snprintf(text, sizeof text, "The scan needs about %.0f MB for its log, but %.0f MB are free in ",
                    wanted / 1e6, free / 1e6);
      return not_kept(text + task.log_file.parent_path().string() + "; free space or ask for fewer profiles.");
    }
  }
  LogHeader header;
  header.date = task.date;
  header.machine = machine_of(equipment);
  header.camera = equipment.camera.mode().identity;
  header.simulated = is_simulated(equipment);
  header.request = task.request;
  header.calibration = format_calibration(equipment.calibration);
  header.lasers = lasers;
  header.colour = colour;
  auto log = ProfileLogWriter::create(task.log_file, header);
  if (!log) return not_kept(log.error().message);
  return std::move(*log);
}

tl::expected<std::unique_ptr<ProfileLogReader>, ScanStop> coloured_log(const ScanEquipment& equipment,
                                                                       const ScanTask& task) {
  if (!delivers_colours(equipment, task.request)) return nullptr;
  auto log = ProfileLogReader::open(task.log_file);
  if (!log) return not_kept(log.error().message);
  return std::move(*log);
}

}  // namespace celadon
