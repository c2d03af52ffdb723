#include "daemon/calibration/calibration_record.h"

#include <cmath>
#include <cstdio>
#include <limits>

#include "acquisition/calibrate/target_board.h"
#include "daemon/request_fields.h"

namespace celadon {
namespace {

using nlohmann::json;
namespace fields = request_fields;

constexpr std::size_t kLongestBoard = 64;
constexpr double kLeastSize_mm = 1, kLargestSize_mm = 10'000;
constexpr double kLeastMeasuredU_mm = 1e-4, kLargestMeasuredU_mm = 10;
constexpr double kLongestCalibrationExposure_ms = 1000;
constexpr double kPlausible = 0.05;  // relative difference of a print from what was to be printed

std::string board_field(const json& value) {
  const std::string allowed = "a board as `celadon board` prints it, tags:10x7x12 or chessboard:11x8x8";
  std::string text = fields::text_field("board", value, allowed);
  if (text.size() > kLongestBoard) fields::refuse("board", value, allowed);
  if (auto board = TargetBoard::parse(text); !board) throw fields::Refusal{board.error() + "."};
  return text;
}

std::optional<double> size_field(const std::string& field, const json& value) {
  if (value.is_null()) return std::nullopt;
  return fields::number_between(field, value, kLeastSize_mm, kLargestSize_mm, "mm, or leave it out: not measured");
}

void read_calibration_field(CalibrationRequest& request, const std::string& field, const json& value) {
  if (field == "board") {
    request.board = board_field(value);
  } else if (field == "width_mm") {
    request.width_mm = size_field(field, value);
  } else if (field == "height_mm") {
    request.height_mm = size_field(field, value);
  } else if (field == "measured_u_mm") {
    request.measured_u_mm = fields::number_between(field, value, kLeastMeasuredU_mm, kLargestMeasuredU_mm, "mm");
  } else if (field == "views") {
    request.views = fields::whole_field(field, value, 5, 200);
  } else if (field == "placements") {
    request.placements = fields::whole_field(field, value, 1, 12);
  } else if (field == "angles") {
    request.angles = fields::whole_field(field, value, 8, 360);
  } else if (field == "stops") {
    request.stops = fields::whole_field(field, value, 0, 100);
  } else if (field == "exposure_ms") {
    request.exposure_ms = fields::number_field(field, value, kLongestCalibrationExposure_ms, "ms");
  } else {
    throw fields::Refusal{"'" + field.substr(0, 60) +
                          "' is not a field of a calibration request; give board, width_mm, height_mm, measured_u_mm, "
                          "views, placements, angles, stops or exposure_ms."};
  }
}

json look_json(const BoardLook& look) {
  return {{"found", look.found}, {"problem", look.problem}, {"still", look.still},  {"known", look.known},
          {"views", look.views}, {"wanted", look.wanted},   {"advice", look.advice}};
}

json turn_json(const BoardTurn& turn) {
  return {{"placement", turn.placement},
          {"placements", turn.placements},
          {"angle", turn.angle},
          {"angles", turn.angles},
          {"seen", turn.seen}};
}

json values_json(const CalibrationValues& values) {
  return {{"systematic_mm", values.systematic_mm},
          {"corner_rms_px", values.corner_rms_px},
          {"held_out_rms_px", values.held_out_rms_px},
          {"line_rms_mm", values.line_rms_mm},
          {"views", values.views},
          {"left_out", values.left_out}};
}

}  // namespace

json to_json(const CalibrationRequest& request) {
  json out{{"board", request.board},
           {"measured_u_mm", request.measured_u_mm},
           {"views", request.views},
           {"placements", request.placements},
           {"angles", request.angles},
           {"stops", request.stops},
           {"exposure_ms", request.exposure_ms}};
  if (request.width_mm) out["width_mm"] = *request.width_mm;
  if (request.height_mm) out["height_mm"] = *request.height_mm;
  return out;
}

json to_json(const CalibrationRecord& record) {
  json out = job_json(record);
  out["request"] = to_json(record.request);
  out["step"] = record.step;
  out["instruction"] = record.instruction;
  out["message"] = record.message;
  if (record.look) out["look"] = look_json(*record.look);
  if (record.turn) out["turn"] = turn_json(*record.turn);
  json steps = json::array();
  for (const StepVerdict& step : record.steps) {
    steps.push_back(
        {{"name", step.name}, {"verdict", step.verdict}, {"finding", step.finding}, {"remedy", step.remedy}});
  }
  out["steps"] = steps;
  if (!record.verdict.empty()) out["verdict"] = record.verdict;
  if (record.values) out["values"] = values_json(*record.values);
  return out;
}

void read_calibration_findings(const json& in, CalibrationRecord& record) {
  record.step = in.at("step").get<int>();
  record.instruction = in.at("instruction").get<std::string>();
  record.message = in.at("message").get<std::string>();
  record.verdict = in.value("verdict", "");
  for (const json& step : in.at("steps")) {
    record.steps.push_back({step.at("name").get<std::string>(), step.at("verdict").get<std::string>(),
                            step.at("finding").get<std::string>(), step.at("remedy").get<std::string>()});
  }
  if (!in.contains("values")) return;
  const json& v = in["values"];
  // What is no number, because nothing was seen of it, is null in JSON.
  const auto number = [&](const char* name) {
    return v.at(name).is_null() ? std::numeric_limits<double>::quiet_NaN() : v.at(name).get<double>();
  };
  record.values = CalibrationValues{number("systematic_mm"), number("corner_rms_px"),  number("held_out_rms_px"),
                                    number("line_rms_mm"),   v.at("views").get<int>(), v.at("left_out").get<int>()};
}

std::optional<std::string> implausible_size(const CalibrationRequest& request, const TargetBoard& board) {
  const double width_mm = board.columns() * board.square_mm(), height_mm = board.rows() * board.square_mm();
  const auto plausible = [](const std::optional<double>& measured, double nominal) {
    return !measured || std::abs(*measured / nominal - 1) < kPlausible;
  };
  const bool width = plausible(request.width_mm, width_mm);
  if (width && plausible(request.height_mm, height_mm)) return std::nullopt;
  char text[200];
  std::snprintf(text, sizeof text,
                "%s is %g, but %s should be %g x %g mm; measure over all squares, or name the right board.",
                width ? "height_mm" : "width_mm", width ? *request.height_mm : *request.width_mm, request.board.c_str(),
                width_mm, height_mm);
  return text;
}

tl::expected<CalibrationRequest, ServiceError> calibration_request_from_json(const json& body) {
  CalibrationRequest request;
  try {
    if (!body.is_object()) fields::refuse("The calibration request", body, "a JSON object, {} for the defaults");
    for (const auto& [field, value] : body.items()) read_calibration_field(request, field, value);
    if (auto wrong = implausible_size(request, *TargetBoard::parse(request.board))) throw fields::Refusal{*wrong};
  } catch (const fields::Refusal& refusal) {
    return tl::make_unexpected(ServiceError{422, "invalid calibration request", refusal.detail});
  }
  return request;
}

tl::expected<std::optional<int>, ServiceError> confirmed_step_from_json(const json& body) {
  std::optional<int> step;
  try {
    if (!body.is_object()) fields::refuse("The confirmation", body, "a JSON object, {} for the present step");
    for (const auto& [field, value] : body.items()) {
      if (field != "step")
        throw fields::Refusal{"'" + field.substr(0, 60) + "' is not a field of a confirmation; give step."};
      step = fields::whole_field(field, value, 1, 1'000'000);
    }
  } catch (const fields::Refusal& refusal) {
    return tl::make_unexpected(ServiceError{422, "invalid confirmation", refusal.detail});
  }
  return step;
}

}  // namespace celadon
