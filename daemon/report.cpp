#include "daemon/report.h"

#include <algorithm>
#include <numbers>
#include <utility>

namespace celadon {

Eigen::Vector3d size_of(std::span<const RangeFunction* const> pieces) {
  constexpr int kAround = 256, kAlong = 128;
  Eigen::AlignedBox3d box;
  for (const RangeFunction* range : pieces) {
    const BaseSurface& base = range->base();
    for (int i = 0; i <= kAlong; ++i) {
      const double z = base.band_start + (base.band_end - base.band_start) * i / kAlong;
      for (int j = 0; j <= kAround; ++j) {
        const double theta = base.arcs.theta_of_v(base.arcs.count() * static_cast<double>(j) / kAround),
                     range_mm = (*range)(theta, z);
        const double phi = base.spherical() ? BaseSurface::meridian().theta_of_v(z) : 0;
        const double r = base.spherical() ? range_mm * std::sin(phi) : range_mm;
        box.extend(base.X_WB * Eigen::Vector3d(r * std::cos(theta), r * std::sin(theta),
                                               base.spherical() ? range_mm * std::cos(phi) : base.z_mm(theta, z)));
      }
    }
  }
  return box.sizes();
}

namespace {

using Json = nlohmann::ordered_json;

Json to_json(const ErrorSummary& e) {
  return {{"rms", e.rms}, {"p95", e.p95}, {"max", e.max}};
}
Json to_json(const Eigen::Vector3d& v) {
  return Json::array({v.x(), v.y(), v.z()});
}

Json to_json(const ClosureError& e) {
  return {{"bias", e.bias}, {"rms", e.rms}, {"samples", e.samples}};
}

// What each laser saw, and how well two of them agree.
void put_lasers(Json& json, const ResultNotes& notes) {
  if (!notes.lasers.empty()) json["lasers"] = Json::array();
  const bool moved = std::any_of(notes.lasers.begin(), notes.lasers.end(),
                                 [](const LaserShare& share) { return share.stop != AxisStop(); });
  for (const LaserShare& share : notes.lasers) {
    Json entry{{"laser", share.laser}, {"profiles", share.profiles}, {"samples", share.samples}};
    if (moved) {
      entry["elevation_deg"] = share.stop.elevation_rad * 180 / std::numbers::pi;
      entry["lift_mm"] = share.stop.lift_mm;
    }
    if (share.closure_mm) entry["closure_mm"] = to_json(*share.closure_mm);
    json["lasers"].push_back(std::move(entry));
  }
  if (!notes.agreement_mm) return;
  const AgreementError& e = *notes.agreement_mm;
  json["agreement_mm"] = {{"lasers", {e.first, e.second}},
                          {"bias", e.bias},
                          {"bias_sd", e.bias_sd},
                          {"rms", e.rms},
                          {"noise", e.noise},
                          {"shift", e.shift},
                          {"tilt", e.tilt},
                          {"cells", e.cells}};
}

void put_exposures(Json& json, const std::vector<TurnExposures>& turns) {
  bool bracketed = false;
  Json list = Json::array();
  for (std::size_t k = 0; k < turns.size(); ++k) {
    bracketed = bracketed || (k > 0 && turns[k].laser == turns[k - 1].laser);
    Json stretches = Json::array();
    for (const ExposurePlan::Stretch& s : turns[k].stretches) {
      stretches.push_back(
          {{"from_deg", s.from_deg}, {"to_deg", s.to_deg}, {"exposure_ms", static_cast<double>(s.exposure_ns) * 1e-6}});
    }
    list.push_back({{"laser", turns[k].laser}, {"stretches", std::move(stretches)}});
  }
  json["exposures"] = {{"bracketed", bracketed}, {"turns", std::move(list)}};
}

void put_dry_turn(Json& json, const DryTurn& dry) {
  Json& out = json["dry_turn"] = {{"profiles", dry.profiles}, {"sd_mm", dry.sd_mm}};
  if (dry.seconds) out["seconds"] = *dry.seconds;
  out["exposure_ms"] = dry.exposure.exposure_ms;
  out["better_exposure_ms"] = dry.exposure.better_ms;
  out["bright_level"] = dry.view.bright_level;
  out["sectors"] = Json::array();
  for (const ViewSector& s : dry.view.sectors) {
    out["sectors"].push_back({{"profiles", s.profiles},
                              {"rows", s.rows},
                              {"saturated", s.saturated},
                              {"amplitude", s.amplitude},
                              {"cut_above", s.cut_above},
                              {"cut_below", s.cut_below}});
  }
}

void put_counts(Json& json, const RangeFitReport& r) {
  json["points"] = r.points;
  json["rejected"] = r.rejected;
  json["unfollowable"] = r.unfollowable;
}

// The least and the largest height of a rim.
Json extent_of_rim(const BaseSurface& base, double along) {
  constexpr int kAround = 720;
  double least = base.z_mm(0, along), most = least;
  for (int j = 1; j < kAround; ++j) {
    const double z = base.z_mm(2 * std::numbers::pi * j / kAround, along);
    least = std::min(least, z), most = std::max(most, z);
  }
  return Json::array({least, most});
}

// What a surface is and how well its samples lie on it.
void put_surface(Json& json, const RangeFit& fit) {
  const RangeFitReport& r = fit.report;
  const BaseSurface& base = fit.function.base();
  json["base"] = base.spherical() ? "sphere" : "cylinder";
  json["model"] = to_string(r.model, base.kind);
  json["degree"] = {r.degree_u, r.degree_v};
  json["control_points"] = {r.control_points_u, r.control_points_v};
  json["noise_mm"] = r.noise_mm;
  json["kappa"] = r.kappa;
  json["residual_mm"] = to_json(r.residual_mm);
  json["geometric_mm"] = to_json(r.geometric_mm);
  if (r.sd_max_mm > 0) json["sd_mm"] = {{"mean", r.sd_mean_mm}, {"max", r.sd_max_mm}};
  json["coverage"] = r.coverage;
  json["decided_by"] = r.decided_by;
  json["stopped_by"] = r.stopped_by;
  if (!r.poles.empty()) json["poles"] = r.poles;
  json["frame"] = {{"origin", to_json(Eigen::Vector3d(base.X_WB.translation()))},
                   {"z", to_json(Eigen::Vector3d(base.X_WB.linear().col(2)))}};
  if (base.spherical()) {
    json["band_rad"] = {r.phi_start_rad, r.phi_end_rad};
  } else {
    json["band_mm"] = {r.z_start_mm, r.z_end_mm};
  }
  if (!base.arcs.closed()) {
    const double start = base.arcs.start_rad();
    json["angles_rad"] = {start, start + base.arcs.count() * base.arcs.arc_rad()};
  }
  if (base.heights) {
    json["rims_mm"] = {{"lower", extent_of_rim(base, base.band_start)}, {"upper", extent_of_rim(base, base.band_end)}};
  }
  if (!r.constraints.empty()) {
    json["constraints"] = Json::array();
    for (const HeldConstraint& held : r.constraints) {
      const char* const unit = held.is_angle ? "_rad" : "_mm";
      Json entry{{"what", held.what}};
      entry[std::string("held") + unit] = held.asked;
      entry[std::string("alone") + unit] = held.alone;
      entry[std::string("alone_sd") + unit] = held.alone_sd;
      json["constraints"].push_back(std::move(entry));
    }
  }
  if (!r.steps.empty()) {
    json["steps"] = Json::array();
    for (const WallStep& step : r.steps) json["steps"].push_back({{"height_mm", step.z_mm}, {"jump_mm", step.jump_mm}});
  }
  json["cut_mm"] = {{"below", r.cut_below_mm}, {"above", r.cut_above_mm}};
}

void put_heading(Json& json, const ResultNotes& notes) {
  json["format"] = "celadon-report";
  json["version"] = 1;
  json["units"] = {{"length", "mm"}, {"angle", "rad"}, {"time", "s"}};
  json["name"] = notes.name;
  json["date"] = notes.date;
  json["machine"] = notes.machine;
  json["simulated"] = notes.simulated;
}

// What follows the surface: the same for every shape.
void put_notes(Json& json, const std::vector<std::string>& warnings_of_fit, const ResultNotes& notes) {
  if (!notes.shape_reason.empty()) json["shape_reason"] = notes.shape_reason;
  Json warnings = Json::array();
  for (const std::string& text : warnings_of_fit) warnings.push_back(text);
  for (const std::string& text : notes.warnings) warnings.push_back(text);
  json["warnings"] = std::move(warnings);
  Json seconds = Json::object();
  for (const StageSeconds& s : notes.seconds) seconds[s.stage] = s.seconds;
  json["seconds"] = std::move(seconds);
  if (notes.truth_mm) {
    json["truth_mm"] = {{"bias", notes.truth_mm->bias}, {"rms", notes.truth_mm->rms}, {"max", notes.truth_mm->max}};
  }
  if (notes.scan) {
    const ScanCounters& s = *notes.scan;
    json["scan"] = {{"mode", s.mode},
                    {"profiles", s.profiles},
                    {"frames", s.frames},
                    {"lost", s.lost},
                    {"stale", s.stale},
                    {"corrupt", s.corrupt},
                    {"rows_ambiguous", s.rows_ambiguous}};
  }
  if (notes.coloured) json["coloured"] = *notes.coloured;
  if (notes.stereo) {
    const StereoShare& s = *notes.stereo;
    json["stereo"] = {{"pair_rad", s.pair_rad},          {"pairs", s.pairs},
                      {"windows", s.counts.windows},     {"found", s.counts.found},
                      {"outside", s.counts.outside},     {"standing", s.counts.standing},
                      {"unknown", s.counts.unknown},     {"plain", s.counts.plain},
                      {"ambiguous", s.counts.ambiguous}, {"inconsistent", s.counts.inconsistent},
                      {"misfit", s.counts.misfit},       {"calibration_mm", s.calibration_mm}};
  }
  if (notes.closure_mm) json["closure_mm"] = to_json(*notes.closure_mm);
  put_lasers(json, notes);
  if (!notes.exposures.empty()) put_exposures(json, notes.exposures);
  if (!notes.checks.empty()) json["checks"] = to_json(notes.checks);
  if (notes.dry_turn) put_dry_turn(json, *notes.dry_turn);
  if (!notes.dimensions.empty()) {
    Json list = Json::array();
    for (const Dimension& d : notes.dimensions) {
      list.push_back({{"name", d.name},
                      {"unit", d.unit},
                      {"value", d.value},
                      {"standard_uncertainty", d.u},
                      {"of_scatter", d.u_scatter},
                      {"of_calibration", d.u_calibration}});
    }
    json["dimensions"] = std::move(list);
  }
  if (notes.calibration) {
    json["calibration"] = {{"date", notes.calibration->date},
                           {"systematic_mm", notes.calibration->systematic_mm},
                           {"scale_u", notes.calibration->scale_u}};
  }
  if (notes.solid) {
    if (notes.solid->closed) {
      json["solid"] = {
          {"volume_mm3", notes.solid->volume_mm3}, {"valid", notes.solid->valid}, {"faces", notes.solid->faces}};
    } else {
      json["shell"] = {{"valid", notes.solid->valid}, {"faces", notes.solid->faces}};
    }
  }
  if (notes.own_axis) {
    const LocalFrame& own = *notes.own_axis;
    json["own_axis"] = {{"shape", to_string(own.shape)},
                        {"reason", own.reason},
                        {"axis_sd_rad", own.axis_sd_rad},
                        {"origin_sd_mm", own.origin_sd_mm},
                        {"inliers", own.inliers}};
  }
  if (notes.turned_over) {
    const PoseAlignment& pose = *notes.turned_over;
    json["turned_over"] = {{"overlap", pose.overlap},
                           {"scale_mm", pose.scale_mm},
                           {"shift_sd_mm", pose.shift_sd_mm},
                           {"turn_sd_rad", pose.turn_sd_rad}};
  }
  if (notes.flat_ends.any()) {
    const auto face = [](const FlatEnd& end) {
      return Json{{"height_mm", end.height_mm}, {"tilt_rad", end.tilt_rad()}, {"share", end.share}};
    };
    json["flat_ends"] = Json::object();
    if (notes.flat_ends.lower) json["flat_ends"]["lower"] = face(*notes.flat_ends.lower);
    if (notes.flat_ends.upper) json["flat_ends"]["upper"] = face(*notes.flat_ends.upper);
  }
  if (notes.raised)
    json["raised"] = {
        {"asked_mm", notes.raised->asked_mm}, {"lift_mm", notes.raised->lift_mm}, {"sd_mm", notes.raised->sd_mm}};
  if (notes.symmetry) {
    json["symmetry"] = {{"fold", notes.symmetry->fold}};
    if (notes.symmetry->mirrored) json["symmetry"]["mirror_plane_rad"] = notes.symmetry->plane_rad;
  }
  if (notes.about_scanner_axis) {
    const RangeFitReport& there = *notes.about_scanner_axis;
    json["about_scanner_axis"] = {{"model", to_string(there.model)},
                                  {"degree", {there.degree_u, there.degree_v}},
                                  {"control_points", {there.control_points_u, there.control_points_v}},
                                  {"noise_mm", there.noise_mm}};
  }
}

}  // namespace

nlohmann::ordered_json report_json(const RangeFit& fit, const ResultNotes& notes) {
  Json json;
  put_heading(json, notes);
  put_counts(json, fit.report);
  put_surface(json, fit);
  const RangeFunction* const piece = &fit.function;
  json["size_mm"] = to_json(size_of(std::span(&piece, 1)));
  put_notes(json, fit.report.warnings, notes);
  return json;
}

nlohmann::ordered_json report_json(const CompositeFit& fit, const ResultNotes& notes) {
  Json json;
  put_heading(json, notes);
  put_counts(json, fit.report);
  json["base"] = "composite";
  json["model"] = "composite";
  json["noise_mm"] = fit.report.noise_mm;
  json["kappa"] = fit.report.kappa;
  json["residual_mm"] = to_json(fit.report.residual_mm);
  json["geometric_mm"] = to_json(fit.report.geometric_mm);
  json["coverage"] = fit.report.coverage;
  std::vector<const RangeFunction*> ranges;
  json["pieces"] = Json::array();
  for (const RangeFit& fitted : fit.pieces) {
    Json piece;
    put_counts(piece, fitted.report);
    put_surface(piece, fitted);
    json["pieces"].push_back(std::move(piece));
    ranges.push_back(&fitted.function);
  }
  const auto meeting = [](const Meeting& m) { return Json{{"gap_mm", m.gap_mm}, {"angle_rad", m.angle_rad}}; };
  json["joints"] = Json::array();
  for (const CompositeJoint& joint : fit.joints)
    json["joints"].push_back(
        {{"height_mm", joint.height_mm}, {"before", meeting(joint.before)}, {"after", meeting(joint.after)}});
  if (!fit.shoulders.empty()) json["shoulders"] = Json::array();
  for (const Shoulder& shoulder : fit.shoulders)
    json["shoulders"].push_back({{"height_mm", shoulder.height_mm},
                                 {"sd_mm", shoulder.sd_mm},
                                 {"jump_mm", shoulder.jump_mm},
                                 {"edge_mm", shoulder.edge_mm},
                                 {"seen", shoulder.seen},
                                 {"scatter_mm", shoulder.scatter_mm}});
  json["size_mm"] = to_json(size_of(ranges));
  put_notes(json, fit.report.warnings, notes);
  return json;
}

nlohmann::ordered_json report_json(std::uint64_t points, const ResultNotes& notes) {
  Json json;
  put_heading(json, notes);
  json["points"] = points;
  json["base"] = "none";
  put_notes(json, {}, notes);
  return json;
}

std::string format_report(const nlohmann::ordered_json& report) {
  return report.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace celadon
