#include "daemon/calibration/calibration_job.h"

#include <algorithm>
#include <cstdio>
#include <utility>

#include "acquisition/calibrate/calibration_solver.h"
#include "acquisition/datum/rim_survey.h"
#include "daemon/calibration/calibration_session.h"
#include "daemon/frame_feed.h"
#include "daemon/utc_time.h"

namespace celadon {
namespace {

using Failed = tl::unexpected<ScanStop>;

constexpr std::size_t kFewestRimTags = 3;

const char* word(Verdict verdict) {
  return verdict == Verdict::good ? "good" : verdict == Verdict::usable ? "usable" : "refused";
}

Measured pitch(const std::optional<double>& measured_mm, double nominal_mm, double u_mm) {
  if (!measured_mm) return {1, 0.003};
  return {*measured_mm / nominal_mm, u_mm / nominal_mm};
}

CalibrationPlan plan_of(const CalibrationRequest& request, bool from_afar) {
  CalibrationPlan plan{*TargetBoard::parse(request.board)};
  plan.held_views = request.views;
  plan.placements = request.placements;
  plan.angles = request.angles;
  plan.exposure_ms = request.exposure_ms;
  plan.pitch_x = pitch(request.width_mm, plan.board.columns() * plan.board.square_mm(), request.measured_u_mm);
  plan.pitch_y = pitch(request.height_mm, plan.board.rows() * plan.board.square_mm(), request.measured_u_mm);
  plan.stops = request.stops;
  plan.from_afar = from_afar;
  return plan;
}

/// The platter's fiducials: without them scans watch less, but measure as well.
StepVerdict datum_step(const std::vector<RimTag>& tags) {
  if (tags.size() < kFewestRimTags) {
    return {"datum", word(Verdict::usable),
            "Of the platter's fiducials " + std::to_string(tags.size()) +
                " were seen well at three angles or more: scans will not watch them.",
            "Light the platter and free its rim."};
  }
  double u = 0;
  for (const RimTag& tag : tags) u = std::max(u, tag.u_mm);
  char text[120];
  std::snprintf(text, sizeof text, "%zu fiducials on the platter, each known to %.3f mm.", tags.size(), u);
  return {"datum", word(Verdict::good), text, ""};
}

}  // namespace

tl::expected<CalibrationOutcome, ScanStop> run_calibration(ScannerConnection& machine,
                                                           const CalibrationRequest& request, bool from_afar,
                                                           CalibrationGuide& guide) {
  const CalibrationPlan plan = plan_of(request, from_afar);
  auto input = take_calibration_views(machine, plan, guide);
  if (!input) return Failed(input.error());
  guide.on_state(ScanState::solving);
  auto solved = solve_calibration(*input);
  if (const auto whom = guide.cancelled()) return Failed(cancelled_by(*whom));
  if (!solved) {
    return Failed(ScanStop{ScanState::failed, "No calibration comes of the views: " + solved.error(), false, false,
                           ScanFailure::data});
  }
  CalibrationOutcome outcome;
  outcome.verdict = word(solved->verdict);
  for (const CalibrationStep& step : solved->steps)
    outcome.steps.push_back({step.name, word(step.verdict), step.finding, step.remedy});
  outcome.values = {solved->calibration.systematic_mm,
                    solved->corner_rms_px,
                    solved->held_out_rms_px,
                    solved->line_rms_mm,
                    static_cast<int>(input->views.size()),
                    static_cast<int>(solved->left_out.size())};
  if (solved->verdict == Verdict::refused) return outcome;
  Calibration& c = outcome.calibration.emplace(std::move(solved->calibration));
  c.machine = machine.device->identity().machine;
  c.camera = machine.camera->mode().identity;
  c.date = utc_now();
  c.simulated = is_simulated(machine);
  c.rim_tags = survey_rim(c, input->rim);
  if (!input->rim.empty()) outcome.steps.push_back(datum_step(c.rim_tags));
  return outcome;
}

}  // namespace celadon
