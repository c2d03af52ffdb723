#pragma once
// A calibration as a job of the machine's owner: what a client asks for, and what it may see of it.

#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>
#include <tl/expected.hpp>

#include "daemon/calibration/board_look.h"
#include "daemon/job_record.h"
#include "daemon/service_error.h"

namespace celadon {

class TargetBoard;

/// What a client asks for; every field has a default.
struct CalibrationRequest {
  std::string board = "tags:10x7x12";  ///< as TargetBoard::parse reads it
  /// Measured over all squares of the print; nullopt: not measured, lengths are 0.3 % unsure.
  std::optional<double> width_mm, height_mm;
  double measured_u_mm = 0.1;  ///< standard uncertainty of both
  int views = 25;              ///< of the board held by hand, 5 .. 200
  int placements = 3;          ///< of the board on the platter, 1 .. 12
  int angles = 36;             ///< of the table, a turn, 8 .. 360
  int stops = 8;               ///< of head and lift, for each placement, 0 .. 100; 0: they are not calibrated
  double exposure_ms = 0;      ///< 0: as the camera stands
};

/// A step of a calibration with its verdict: "good", "usable" or "refused".
struct StepVerdict {
  std::string name, verdict;
  std::string finding;  ///< values and limits in one sentence
  std::string remedy;   ///< empty if good
};

/// How well a calibration is known.
struct CalibrationValues {
  double systematic_mm = 0;  ///< standard uncertainty of a radius
  double corner_rms_px = 0, held_out_rms_px = 0, line_rms_mm = 0;
  int views = 0, left_out = 0;
};

/// A turn of the table with the board on it, so far.
struct BoardTurn {
  int placement = 0, placements = 0;  ///< from 1 on
  int angle = 0, angles = 0;          ///< looked at, of so many
  int seen = 0;                       ///< of them showed the board
};

struct CalibrationRecord : JobRecord {
  CalibrationRequest request;
  int step = 0;             ///< number of the newest instruction, from 1 on; 0: none yet
  std::string instruction;  ///< what has to be done by hand
  std::string message;      ///< what was seen last, one sentence
  std::optional<BoardLook> look;
  std::optional<BoardTurn> turn;
  std::string verdict;  ///< the worst of the steps; empty: not solved yet
  std::vector<StepVerdict> steps;
  std::optional<CalibrationValues> values;
};

/// JSON as in openapi.yaml.
nlohmann::json to_json(const CalibrationRecord& record);
nlohmann::json to_json(const CalibrationRequest& request);
/// Checks every field, and the measured sizes against the board.
tl::expected<CalibrationRequest, ServiceError> calibration_request_from_json(const nlohmann::json& json);
/// Which step a client confirms: of {"step": 2} 2, of {} none in particular.
tl::expected<std::optional<int>, ServiceError> confirmed_step_from_json(const nlohmann::json& json);
/// The fields of an object that to_json() made, but for those of a JobRecord. @throws nlohmann::json::exception
void read_calibration_findings(const nlohmann::json& json, CalibrationRecord& record);

/// What is wrong with the measured sizes of the request's board, in one sentence; nullopt: they are plausible.
std::optional<std::string> implausible_size(const CalibrationRequest& request, const TargetBoard& board);

}  // namespace celadon
