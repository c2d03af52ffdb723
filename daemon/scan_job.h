#pragma once
// One scan from the first poll to the last file, on equipment that somebody else owns.

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibration.h"
#include "acquisition/frame.h"
#include "acquisition/triangulation.h"
#include "daemon/checks/self_check.h"
#include "daemon/scan_service.h"
#include "daemon/scan_truth.h"
#include "firmware_bridge/clock.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon {

/// What a scan runs on; borrowed for its duration by the thread that owns it.
struct ScanEquipment {
  ScannerDevice* device;  ///< nullptr with a recording, whose frames know their angles
  FrameSource& camera;
  Clock& clock;                    ///< of device and camera
  const Calibration& calibration;  ///< checked against machine and camera
  TruthSource* truth = nullptr;    ///< simulated machines only
  ScanVolume volume;
};

struct ScanTask {
  ScanRequest request;
  std::string date;                             ///< ISO 8601 UTC
  std::filesystem::path log_file;               ///< must not exist
  std::filesystem::path results_folder;         ///< must not exist
  std::filesystem::path recording_folder = {};  ///< of the frames, if they shall be kept; must not exist
  std::vector<std::string> warnings = {};       ///< what is known before the scan and belongs into its report
  bool from_afar = false;  ///< not by the machine's own button: needs its switch, and a warning before anything moves
};

/// Who watches a scan. Called from the scan's thread, between two frames; must return at once.
class ScanObserver {
 public:
  virtual ~ScanObserver() = default;
  virtual void on_state(ScanState state) = 0;
  virtual void on_progress(const ScanProgress& progress) = 0;
  virtual void on_status(const DeviceStatus& status) = 0;
  /// Why the scan shall end now; nullopt: it goes on.
  virtual std::optional<std::string> cancelled() = 0;
};

/// Why a scan ended before its time: state failed or cancelled and one sentence with the remedy.
struct ScanStop {
  ScanState state = ScanState::failed;
  std::string reason;
  bool device_lost = false, camera_lost = false;  ///< connect again before the next scan
  ScanFailure failure = ScanFailure::device;      ///< of failed
  bool camera_was_gone = false;                   ///< before the scan began: a new connection may serve it
};

/// What a finished scan leaves.
struct ScanOutcome {
  std::vector<std::string> files;     ///< names in the results folder
  std::vector<std::string> warnings;  ///< as in the report
  std::vector<SelfCheck> checks;      ///< as in the report
  double last_frame_to_step_s = 0;    ///< 0 without a STEP file
};

/// Make ready; move, frame, line, profile, log, accumulate; make safe; solve; exact NURBS; files and report.
/// On every way out the lasers are off and the motor stands, and the log is kept.
tl::expected<ScanOutcome, ScanStop> run_scan(const ScanEquipment& equipment, const ScanTask& task,
                                             ScanObserver& observer);

}  // namespace celadon
