#include "daemon/scan_service.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include <nlohmann/json.hpp>

#include "daemon/request_fields.h"

namespace celadon {
namespace {

using nlohmann::json;
using request_fields::number_field, request_fields::one_of, request_fields::refuse, request_fields::Refusal,
    request_fields::text_field, request_fields::whole_field;

constexpr std::size_t kLongestName = 64;
constexpr int kFewestProfiles = 16, kMostProfiles = 100'000;
constexpr int kMostLasers = 4;          // of a controller (firmware_bridge/PROTOCOL.md)
constexpr std::size_t kMostStops = 16;  // of one axis
constexpr double kLargestElevation_deg = 90, kLargestLift_mm = 1000;
constexpr double kLongestExposure_ms = 1000, kLargestTolerance_mm = 100;
constexpr std::array<const char*, 5> kShapes = {"cylinder", "sphere", "composite", "auto", "none"};
constexpr std::array<const char*, 5> kModels = {"auto", "cylinder", "revolution", "translational", "general"};
constexpr std::array<const char*, 4> kFormats = {"step", "stl", "ply", "surface.json"};

constexpr int kFewestStereoProfiles = 36, kMostStereoProfiles = 720;
constexpr std::array<const char*, 2> kMethods = {"laser", "stereo"};

const char* to_text(ScanMode mode) {
  return mode == ScanMode::step ? "step" : "sweep";
}

json request_json(const ScanRequest& request) {
  json j = {{"name", request.name},
            {"mode", to_text(request.mode)},
            {"profiles", request.profiles},
            {"exposure_ms", request.exposure_auto ? json("auto") : json(request.exposure_ms)},
            {"shape", request.shape},
            {"model", request.model},
            {"tolerance_mm", request.tolerance_mm},
            {"degree_u", request.degree_u},
            {"degree_v", request.degree_v},
            {"formats", request.formats}};
  // Left out where nothing was asked for: programs from before there was a choice read such requests.
  if (!request.lasers.empty()) j["lasers"] = request.lasers;
  if (!request.elevations_deg.empty()) j["elevations_deg"] = request.elevations_deg;
  if (!request.lifts_mm.empty()) j["lifts_mm"] = request.lifts_mm;
  if (request.method == ScanMethod::stereo) j["method"] = "stereo";
  if (request.dry_turn) j["dry_turn"] = true;
  if (request.form_tolerance_mm) j["form_tolerance_mm"] = *request.form_tolerance_mm;
  return j;
}

json link_json(const LinkState& link) {
  return {{"requests", link.requests},           {"retries", link.retries},
          {"time_outs", link.time_outs},         {"broken_replies", link.broken_replies},
          {"exceptions", link.exceptions},       {"reconnects", link.reconnects},
          {"round_trip_ms", link.round_trip_ms}, {"longest_round_trip_ms", link.longest_round_trip_ms}};
}

json progress_json(const ScanProgress& p) {
  return {{"angle_deg", p.angle_deg},
          {"fraction", p.fraction},
          {"frames", p.frames},
          {"frames_expected", p.frames_expected},
          {"frames_lost", p.frames_lost},
          {"stale_frames", p.stale_frames},
          {"frames_per_second", p.frames_per_second},
          {"samples", p.samples},
          {"rejected", p.rejected},
          {"fit_rms_mm", p.fit_rms_mm ? json(*p.fit_rms_mm) : json(nullptr)},
          {"seconds_left", p.seconds_left}};
}

double exposure_field(const json& value) {
  if (value.is_string()) {
    refuse("exposure_ms", value,
           "\"auto\", or a number from 0 to " + std::to_string(static_cast<int>(kLongestExposure_ms)) + " ms");
  }
  return number_field("exposure_ms", value, kLongestExposure_ms, "ms");
}

std::string name_field(const json& value) {
  const std::string allowed = "at most 64 letters, digits, '-', '_', '.' and blanks, not starting with '.' or a blank";
  std::string name = text_field("name", value, allowed);
  const bool good = std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_' ||
           c == '.' || c == ' ';
  });
  if (!good || name.size() > kLongestName || (!name.empty() && (name.front() == '.' || name.front() == ' '))) {
    refuse("name", value, allowed);
  }
  return name;
}

std::vector<int> lasers_field(const json& value) {
  const std::string allowed = "\"all\" or a list of different numbers from 0 to " + std::to_string(kMostLasers - 1);
  std::vector<int> lasers;
  if (value == "all") return lasers;
  if (!value.is_array()) refuse("lasers", value, allowed);
  for (const json& entry : value) {
    lasers.push_back(whole_field("lasers", entry, 0, kMostLasers - 1));
  }
  if (std::set<int>(lasers.begin(), lasers.end()).size() != lasers.size()) refuse("lasers", value, allowed);
  return lasers;
}

std::vector<double> positions_field(const std::string& field, const json& value, double size, const char* unit) {
  const std::string most = std::to_string(static_cast<int>(size));
  const std::string allowed = "a list of at most " + std::to_string(kMostStops) + " different numbers from -" + most +
                              " to " + most + " " + unit;
  if (!value.is_array() || value.size() > kMostStops) refuse(field, value, allowed);
  std::vector<double> positions;
  for (const json& entry : value) {
    if (!entry.is_number() || !(std::abs(entry.get<double>()) <= size)) refuse(field, value, allowed);
    positions.push_back(entry.get<double>());
  }
  if (std::set<double>(positions.begin(), positions.end()).size() != positions.size()) refuse(field, value, allowed);
  return positions;
}

void read_field(ScanRequest& request, const std::string& field, const json& value) {
  if (field == "name") {
    request.name = name_field(value);
  } else if (field == "method") {
    request.method = one_of(field, value, kMethods) == "stereo" ? ScanMethod::stereo : ScanMethod::laser;
  } else if (field == "mode") {
    const std::array<const char*, 2> modes = {"step", "sweep"};
    request.mode = one_of(field, value, modes) == "step" ? ScanMode::step : ScanMode::sweep;
  } else if (field == "profiles") {
    request.profiles = whole_field(field, value, kFewestProfiles, kMostProfiles);
  } else if (field == "dry_turn") {
    if (!value.is_boolean()) refuse(field, value, "true or false");
    request.dry_turn = value.get<bool>();
  } else if (field == "exposure_ms") {
    request.exposure_auto = value == "auto";
    request.exposure_ms = request.exposure_auto ? 0 : exposure_field(value);
  } else if (field == "lasers") {
    request.lasers = lasers_field(value);
  } else if (field == "elevations_deg") {
    request.elevations_deg = positions_field(field, value, kLargestElevation_deg, "degrees");
  } else if (field == "lifts_mm") {
    request.lifts_mm = positions_field(field, value, kLargestLift_mm, "mm");
  } else if (field == "shape") {
    request.shape = one_of(field, value, kShapes);
  } else if (field == "model") {
    request.model = one_of(field, value, kModels);
  } else if (field == "tolerance_mm") {
    request.tolerance_mm = number_field(field, value, kLargestTolerance_mm, "mm");
  } else if (field == "form_tolerance_mm") {
    if (value.is_null()) return;
    request.form_tolerance_mm = number_field(field, value, kLargestTolerance_mm, "mm");
  } else if (field == "degree_u") {
    request.degree_u = whole_field(field, value, 1, 5);
  } else if (field == "degree_v") {
    request.degree_v = whole_field(field, value, 1, 5);
  } else if (field == "formats") {
    if (!value.is_array()) refuse(field, value, "a list of step, stl, ply, surface.json");
    request.formats.clear();
    for (const json& entry : value) {
      const std::string format = one_of("formats", entry, kFormats);
      if (std::find(request.formats.begin(), request.formats.end(), format) == request.formats.end()) {
        request.formats.push_back(format);
      }
    }
  } else {
    throw Refusal{
        "'" + field.substr(0, 60) +
        "' is not a field of a scan request; give name, method, mode, profiles, dry_turn, exposure_ms, lasers, "
        "elevations_deg, lifts_mm, shape, model, tolerance_mm, form_tolerance_mm, degree_u, degree_v or "
        "formats."};
  }
}

/// What a scan by stereo is where nothing was said, and what it cannot be.
void settle_stereo(ScanRequest& request, const json& body) {
  if (body.contains("mode") && request.mode != ScanMode::step)
    refuse("mode", body["mode"], "step with the method stereo, whose table stands for each picture, or leave it out");
  request.mode = ScanMode::step;
  if (!body.contains("profiles")) request.profiles = kStereoProfiles;
  whole_field("profiles, with the method stereo,", request.profiles, kFewestStereoProfiles, kMostStereoProfiles);
  if (!request.lasers.empty()) refuse("lasers", body["lasers"], "no lasers with the method stereo, which uses none");
  if (!request.elevations_deg.empty())
    refuse("elevations_deg", body["elevations_deg"], "no elevations with the method stereo, which scans at 0");
  if (!request.lifts_mm.empty())
    refuse("lifts_mm", body["lifts_mm"], "no heights with the method stereo, which scans at 0");
  if (request.dry_turn) refuse("dry_turn", true, "no dry turn with the method stereo, whose first pair says as much");
  if (request.exposure_auto)
    refuse("exposure_ms", "auto", "a number of milliseconds with the method stereo, which sees no laser's line");
}

}  // namespace

json to_json(const ScanRecord& record) {
  json out = job_json(record);
  out["request"] = request_json(record.request);
  out["progress"] = progress_json(record.progress);
  if (record.state == ScanState::done) out["checks"] = to_json(record.checks);
  return out;
}

json to_json(const MachineState& machine) {
  const auto travel = [](const std::optional<AxisTravel>& axis) {
    return axis ? json{{"lowest", axis->lowest}, {"highest", axis->highest}} : json(nullptr);
  };
  const auto& test = machine.self_test;
  return {{"connected", machine.connected},
          {"machine", machine.machine},
          {"device_url", machine.device_url},
          {"camera_url", machine.camera_url},
          {"error", machine.error},
          {"simulated", machine.simulated},
          {"motion", machine.motion},
          {"angle_deg", machine.angle_deg},
          {"lasers", machine.lasers},
          {"elevation_deg", travel(machine.travels.elevation_deg)},
          {"lift_mm", travel(machine.travels.lift_mm)},
          {"interlock_closed", machine.interlock_closed},
          {"laser_on", machine.laser_on},
          {"fault", machine.fault},
          {"remote_enabled", machine.remote_enabled},
          {"found", machine.found},
          {"link", link_json(machine.link)},
          {"calibrated", machine.calibrated},
          {"calibration_due", machine.calibration_due},
          {"button", machine.button},
          {"self_test", test ? json{{"passed", test->passed}, {"text", test->text}} : json(nullptr)},
          {"state", to_string(machine.state)},
          {"current_scan", machine.current_scan},
          {"current_calibration", machine.current_calibration}};
}

tl::expected<ScanRequest, ServiceError> scan_request_from_json(const json& body) {
  ScanRequest request;
  try {
    if (!body.is_object()) refuse("The scan request", body, "a JSON object, {} for the defaults");
    for (const auto& [field, value] : body.items()) read_field(request, field, value);
    if (request.method == ScanMethod::stereo) settle_stereo(request, body);
    if (request.dry_turn && request.exposure_auto)
      refuse("exposure_ms", "auto",
             "a number of milliseconds with dry_turn: a scan with auto makes quick turns of its own");
    if (request.dry_turn && !request.fits_surface()) {
      throw Refusal{"dry_turn foretells a surface and shape none asks for none; give one of them."};
    }
  } catch (const Refusal& refusal) {
    return tl::make_unexpected(ServiceError{422, "invalid scan request", refusal.detail});
  }
  return request;
}

}  // namespace celadon
