#include "acquisition/calibrate/stop_verdicts.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>
#include <string>

#include "acquisition/calibrate/step_judge.h"

namespace celadon::calibrate {
namespace {

constexpr double kInDegrees = 180 / std::numbers::pi;
/// What the file can hold: an axis further from where it belongs is refused by its reader.
constexpr double kMostOff_deg = 45;

/// What an axis read while the board was seen.
struct Readings {
  bool asked = false;              ///< a view was taken off 0, used or not
  int stops = 0;                   ///< different readings off 0 of views in use
  double lowest = 0, highest = 0;  ///< of all, 0 included
};

/// @param of reading of a view  @param tolerance within which two readings are the same
template <typename Reading>
Readings readings_of(const Observations& observations, double tolerance, Reading&& of) {
  Readings out;
  std::set<long> different;
  for (const ViewObservation& view : observations.views) {
    if (!view.turned()) continue;
    const double reading = of(view);
    const bool off_zero = std::abs(reading) > tolerance;
    out.asked = out.asked || off_zero;
    if (!view.used || !off_zero) continue;
    different.insert(std::lround(reading / tolerance));
    out.lowest = std::min(out.lowest, reading);
    out.highest = std::max(out.highest, reading);
  }
  out.stops = static_cast<int>(different.size());
  return out;
}

void judge_scale_of_readings(double scale, StepJudge& judge) {
  judge.say(Verdict::good, "true / read " + std::to_string(scale));
  judge.at_most("|scale - 1|", std::abs(scale - 1), "", 0.02, 0.2,
                "see that the controller's steps of this axis are those of the machine");
}

CalibrationStep judge_elevation(const Readings& readings, const Estimate& estimate, const Uncertainty& uncertainty,
                                const CalibrationSolution& solution) {
  StepJudge judge("elevation");
  const std::string more =
      "lean the board on the platter back, so that the raised head sees its face, and take views at more elevations, "
      "further apart";
  judge.at_least("the board on the platter seen at", readings.stops, " elevations besides 0", 5, 2, more);
  judge.at_least("over", (readings.highest - readings.lowest) * kInDegrees, " degrees", 30, 10, more);
  if (!estimate.elevation) {
    judge.say(Verdict::refused, "they show no axis that the head turns about",
              more + ", and see that the head moves when its reading does");
    return judge.step();
  }
  const int first = uncertainty.layout().elevation;
  judge.at_most("error of held-out raised views", solution.held_out_raised_px, " px", 0.2, 0.6,
                "see that the board stands still on the platter while the head moves, and that the head does not bend");
  judge.at_most("u(direction)", uncertainty.worst_of_two(first), " rad", 6e-4, 3e-3, more);
  judge.at_most("u(position)", uncertainty.worst_of_two(first + 2, Uncertainty::Scale::known), " mm", 0.03, 0.15, more);
  judge.at_most("u(scale)", uncertainty.of(first + 4), "", 3e-4, 3e-3, more);
  judge_scale_of_readings(estimate.elevation->scale, judge);
  const double up = std::min(1.0, std::abs(solution.calibration.elevation->direction.z()));
  judge.at_most("off horizontal by", std::asin(up) * kInDegrees, " degrees", 5, kMostOff_deg,
                "see that the readings of this axis are those of the head's elevation");
  return judge.step();
}

CalibrationStep judge_lift(const Readings& readings, const Estimate& estimate, const Uncertainty& uncertainty,
                           const CalibrationSolution& solution) {
  StepJudge judge("lift");
  const std::string more =
      "stand the board in the middle of the picture and take views at more heights of the lift, further apart";
  judge.at_least("the board on the platter seen at", readings.stops, " heights besides 0", 5, 2, more);
  judge.at_least("over", readings.highest - readings.lowest, " mm", 30, 10, more);
  if (!estimate.lift) {
    judge.say(Verdict::refused, "they show no way of the lift",
              more + ", and see that the table moves when the lift's reading does");
    return judge.step();
  }
  const int first = uncertainty.layout().lift;
  judge.at_most("error of held-out lifted views", solution.held_out_lifted_px, " px", 0.2, 0.6,
                "see that the board stands still on the platter while the lift moves");
  judge.at_most("u(direction)", uncertainty.worst_of_two(first), " rad", 6e-4, 3e-3, more);
  judge.at_most("u(scale)", uncertainty.of(first + 2, Uncertainty::Scale::known), "", 3e-4, 3e-3, more);
  judge_scale_of_readings(estimate.lift->scale, judge);
  const double along = std::clamp(solution.calibration.lift->direction.z(), -1.0, 1.0);
  judge.at_most("off the table's axis by", std::acos(along) * kInDegrees, " degrees", 5, kMostOff_deg,
                "see that rising readings of the lift raise the table");
  return judge.step();
}

}  // namespace

std::vector<CalibrationStep> judge_stops(const Observations& observations, const Estimate& estimate,
                                         const Uncertainty& uncertainty, const CalibrationSolution& solution) {
  const Readings raised =
      readings_of(observations, kAtZero_rad, [](const ViewObservation& view) { return view.stop.elevation_rad; });
  const Readings lifted =
      readings_of(observations, kAtZero_mm, [](const ViewObservation& view) { return view.stop.lift_mm; });
  std::vector<CalibrationStep> out;
  if (raised.asked) out.push_back(judge_elevation(raised, estimate, uncertainty, solution));
  if (lifted.asked) out.push_back(judge_lift(lifted, estimate, uncertainty, solution));
  return out;
}

}  // namespace celadon::calibrate
