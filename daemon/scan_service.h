#pragma once
// What the clients of the one owner of the device (button, command line, network) may ask. Thread-safe; no call waits
// for the device. Implemented by scan_queue.cpp, served by http/.

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>
#include <tl/expected.hpp>

#include "daemon/calibration/calibration_record.h"
#include "daemon/checks/self_check.h"
#include "daemon/job_record.h"
#include "daemon/scan_state.h"
#include "daemon/service_error.h"

namespace celadon {

enum class ScanMode : std::uint8_t { step, sweep };
enum class ScanMethod : std::uint8_t {
  laser,
  stereo  ///< pictures of a textured object, a few degrees apart, without a laser
};

inline constexpr int kStereoProfiles = 90;  ///< pictures a turn of a scan by stereo that does not say how many

inline constexpr int kDryProfiles = 96;  ///< of a dry turn

/// What a client asks for; every field has a default.
struct ScanRequest {
  std::string name;  ///< of the object; letters, digits, "-_. "; becomes part of file names
  ScanMethod method = ScanMethod::laser;
  ScanMode mode = ScanMode::sweep;          ///< by stereo always in steps
  int profiles = 1200;                      ///< a turn, 16 .. 100000
  bool dry_turn = false;                    ///< only kDryProfiles of them and no files: what would such a scan be?
  double exposure_ms = 0;                   ///< 0: as the camera stands
  bool exposure_auto = false;               ///< found from the line's own peaks; exposure_ms is not looked at
  std::vector<int> lasers = {};             ///< a turn with each, in this order; empty: all that are calibrated
  std::vector<double> elevations_deg = {};  ///< of the head: a turn at each; empty: at 0
  std::vector<double> lifts_mm = {};        ///< of the table: all of them at each; empty: at 0
  std::string shape = "cylinder";           ///< cylinder|sphere|composite|auto; none: the samples are the result
  std::string model = "auto";               ///< auto|cylinder|revolution|translational|general
  double tolerance_mm = 0;                  ///< 0: what the data carry
  std::optional<double> form_tolerance_mm;
  int degree_u = 3, degree_v = 3;
  std::vector<std::string> formats = {"step", "stl", "ply", "surface.json"};  ///< report.json is always written

  bool fits_surface() const { return shape != "none"; }
};

struct ScanProgress {
  double angle_deg = 0;  ///< turned so far
  double fraction = 0;   ///< of the whole scan, 0..1
  int frames = 0, frames_expected = 0, frames_lost = 0, stale_frames = 0;
  double frames_per_second = 0;
  std::uint64_t samples = 0, rejected = 0;
  std::optional<double> fit_rms_mm;  ///< running fit error
  double seconds_left = 0;
};

struct ScanRecord : JobRecord {
  ScanRequest request;
  ScanProgress progress;
  std::vector<SelfCheck> checks;  ///< what the scan found of itself, once done
};

/// How far an axis goes.
struct AxisTravel {
  double lowest = 0, highest = 0;
};

/// Of the axes beside the table; nullopt where the machine has none.
struct AxisTravels {
  std::optional<AxisTravel> elevation_deg, lift_mm;
};

/// How well the link to the controller works, since it was connected.
struct LinkState {
  std::uint64_t requests = 0, retries = 0, time_outs = 0, broken_replies = 0, exceptions = 0, reconnects = 0;
  double round_trip_ms = 0, longest_round_trip_ms = 0;
};

/// What a long press of the button found.
struct SelfTestResult {
  bool passed = false;
  std::string text;  ///< one sentence: what was seen, or what is wrong and the remedy
};

/// For how long a calibration is good; 0: however long.
struct CalibrationLimits {
  std::int64_t days = 180, scans = 1000;
};

struct MachineState {
  bool connected = false;
  std::string machine, device_url, camera_url, error;
  bool simulated = false;
  std::string motion;  ///< "standstill", "moving", ...
  double angle_deg = 0;
  std::vector<int> lasers;  ///< that it has
  AxisTravels travels;
  bool interlock_closed = false, laser_on = false;
  std::string fault;
  bool remote_enabled = true;                ///< the machine's switch, if it has one, allows a start from afar
  std::string found;                         ///< what was found and left when it was connected
  LinkState link;                            ///< to the controller
  std::string calibrated;                    ///< date of the calibration; empty: there is none, and no scan
  std::vector<std::string> calibration_due;  ///< why it is to be made again, a sentence each; empty: it is good
  std::string button;  ///< why the button at the computer cannot be used; empty: it can, or there is none
  std::optional<SelfTestResult> self_test;                  ///< the newest since the daemon started
  ScanState state = ScanState::idle;                        ///< of the job that owns the device
  std::uint64_t current_scan = 0, current_calibration = 0;  ///< 0: none
};

class ScanService {
 public:
  virtual ~ScanService() = default;
  virtual MachineState machine() const = 0;
  virtual tl::expected<ScanRecord, ServiceError> submit(const ScanRequest& request,
                                                        const std::string& requested_by) = 0;
  virtual std::vector<ScanRecord> scans() const = 0;
  virtual std::optional<ScanRecord> scan(std::uint64_t id) const = 0;
  virtual tl::expected<CalibrationRecord, ServiceError> calibrate(const CalibrationRequest& request,
                                                                  const std::string& requested_by) = 0;
  virtual std::vector<CalibrationRecord> calibrations() const = 0;
  virtual std::optional<CalibrationRecord> calibration(std::uint64_t id) const = 0;
  /// What a calibration asked for by hand is done. @param step  number of the instruction; nullopt: the present one
  virtual tl::expected<void, ServiceError> confirm(std::uint64_t id, std::optional<int> step) = 0;
  /// Ends a job that waits or runs.
  virtual tl::expected<void, ServiceError> cancel(std::uint64_t id) = 0;
  /// Calls back with the number of each job that changed: the listener must only take note and return at once. What it
  /// reads of the job meanwhile is never older than what it read before.
  /// @returns a number for unsubscribe, which waits until no call is under way
  virtual std::uint64_t subscribe(std::function<void(std::uint64_t id)> listener) = 0;
  virtual void unsubscribe(std::uint64_t subscription) = 0;
};

/// JSON as in openapi.yaml.
nlohmann::json to_json(const ScanRecord& record);
nlohmann::json to_json(const MachineState& machine);
/// Checks every field; unknown fields, wrong types and values out of range are named.
tl::expected<ScanRequest, ServiceError> scan_request_from_json(const nlohmann::json& json);

}  // namespace celadon
