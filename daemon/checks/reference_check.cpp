#include "daemon/checks/reference_check.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <optional>

#include <nlohmann/json.hpp>

#include "daemon/checks/self_check.h"
#include "daemon/json_field.h"
#include "daemon/shape_least_squares.h"
#include "fitting/round_shapes.h"

namespace celadon {
namespace {

constexpr int kAlong = 40, kAround = 90;
// Noise of standard deviation 1, looked at in thousands of places of which some tens are independent.
constexpr double kPeakToValley = 6;
// Of a sphere, to both sides of its equator: nearer to the poles laser and camera graze it.
constexpr double kZone_rad = std::numbers::pi / 4;

/// Evenly over what is judged: the whole wall, or a sphere's zone about its equator.
Eigen::Matrix3Xd points_of(const RangeFunction& surface) {
  const BaseSurface& base = surface.base();
  double start = base.band_start, end = base.band_end;
  if (base.spherical()) {
    start = std::max(start, BaseSurface::meridian().v_of_theta(std::numbers::pi / 2 - kZone_rad));
    end = std::min(end, BaseSurface::meridian().v_of_theta(std::numbers::pi / 2 + kZone_rad));
  }
  Eigen::Matrix3Xd points(3, kAlong * kAround);
  for (int i = 0; i < kAlong; ++i) {
    const double along = start + (end - start) * (i + 0.5) / kAlong;
    for (int j = 0; j < kAround; ++j) {
      const double theta = base.arcs.theta_of_v(base.arcs.count() * (j + 0.5) / kAround);
      points.col(i * kAround + j) = surface.surface_point(theta, along).p_W;
    }
  }
  return points;
}

template <class... Values>
std::string text_of(const char* format, Values... values) {
  char text[320];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

struct StatedFields {
  double systematic_mm, scale_u;
  std::optional<double> diameter_u_mm;  ///< the calibration's part of a stated diameter
  std::vector<std::string> failed_checks;
};
StatedFields stated_in(const nlohmann::json& report) {
  const JsonField root(report, "");
  if (!root.has("calibration"))
    throw JsonProblem{"there is no field calibration: it is of no scan, or of an older program; scan again"};
  StatedFields stated{
      root.at("calibration").at("systematic_mm").number(), root.at("calibration").at("scale_u").number(), {}, {}};
  if (root.has("dimensions")) {
    for (const auto& dimension : report["dimensions"]) {
      const JsonField field(dimension, "dimensions");
      if (field.at("name").text() == "diameter") stated.diameter_u_mm = field.at("of_calibration").number();
    }
  }
  if (!root.has("checks")) throw JsonProblem{"there is no field checks: it is of no scan; scan again"};
  for (const SelfCheck& check : self_checks_from_json(report["checks"]))
    if (check.verdict == CheckVerdict::failed) stated.failed_checks.push_back(check.name);
  return stated;
}

/// Lowers the verdict to what a value allows.
void judge(ReferenceCheck& check, double value, double good, double usable, const std::string& finding) {
  if (value <= good) return;
  check.findings.push_back(finding);
  check.verdict = std::max(check.verdict, value <= usable ? ReferenceVerdict::usable : ReferenceVerdict::refused);
}

}  // namespace

const char* to_string(ReferenceVerdict verdict) {
  switch (verdict) {
    case ReferenceVerdict::good:
      return "good";
    case ReferenceVerdict::usable:
      return "usable";
    case ReferenceVerdict::refused:
      break;
  }
  return "refused";
}

tl::expected<RoundMeasurement, std::string> measure_round(const SurfaceFile& file, ReferenceShape shape) {
  const bool sphere = shape == ReferenceShape::sphere;
  const auto piece = std::find_if(file.pieces.begin(), file.pieces.end(),
                                  [&](const SurfacePiece& p) { return p.function.base().spherical() == sphere; });
  if (piece == file.pieces.end())
    return tl::make_unexpected(std::string("the surface has no piece over a ") + to_string(shape) +
                               "; scan with --shape " + to_string(shape));
  if (!piece->deviation)
    return tl::make_unexpected(
        "the surface's standard deviation is not known, so nothing can be said of its diameter; scan more of the "
        "object");
  const Eigen::Matrix3Xd points = points_of(piece->function);
  const Eigen::VectorXd weights = Eigen::VectorXd::Ones(points.cols());
  Eigen::VectorXd residuals;
  double radius = 0;
  bool settled = false;
  if (sphere) {
    Sphere best = sphere_through(points, weights);
    settled = least_squares(best, points, weights, residuals);
    radius = best.radius_mm;
  } else {
    Cone best = cylinder_through(points, weights, piece->function.base().X_WB.linear().col(2));
    best.cylinder = true;
    settled = least_squares(best, points, weights, residuals);
    radius = best.radius_mm;
  }
  if (!settled || !(radius > 0))
    return tl::make_unexpected(std::string("no ") + to_string(shape) +
                               " fits the surface; is the reference on the table?");
  return RoundMeasurement{2 * radius, residuals.maxCoeff() - residuals.minCoeff(),
                          piece->deviation->mean(piece->function.base())};
}

tl::expected<ReferenceCheck, std::string> check_reference(const Reference& reference, const SurfaceFile& surface,
                                                          const nlohmann::json& report) {
  ReferenceCheck check;
  check.reference = reference;
  double u_calibration = 0;
  try {
    StatedFields stated = stated_in(report);
    // The joint covariance knows best; without a stated diameter the larger of the two counts, since systematic_mm
    // holds the scale's part where celadon calibrate wrote it.
    u_calibration = stated.diameter_u_mm ? *stated.diameter_u_mm / 2
                                         : std::max(stated.systematic_mm, stated.scale_u * reference.diameter_mm / 2);
    check.failed_checks = std::move(stated.failed_checks);
  } catch (const JsonProblem& problem) {
    return tl::make_unexpected("report.json cannot be judged: " + problem.text);
  } catch (const std::exception& error) {
    return tl::make_unexpected(std::string("report.json cannot be judged: ") + error.what());
  }
  const auto measured = measure_round(surface, reference.shape);
  if (!measured) return tl::make_unexpected(measured.error());
  check.measured = *measured;
  check.calibration_u_mm = u_calibration;
  // A diameter is twice a radius, and k = 2.
  check.U_mm = 2 * 2 * std::hypot(measured->fit_u_mm, u_calibration);
  check.U_reference_mm = 2 * reference.u_then_mm();
  check.difference_mm = measured->diameter_mm - reference.diameter_then_mm();
  const double U_both = std::hypot(check.U_mm, check.U_reference_mm);
  check.normalised_error = U_both > 0 ? std::abs(check.difference_mm) / U_both : INFINITY;
  check.form_expected_mm = kPeakToValley * measured->fit_u_mm + 2 * u_calibration;

  check.verdict = ReferenceVerdict::good;
  const ReferenceLimits& l = check.limits;
  judge(
      check, check.normalised_error, l.error_good, l.error_usable,
      text_of("the diameter is %+.4f mm off, %.2f times what the uncertainties explain (U %.4f mm, reference %.4f mm); "
              "clean the reference, let it take the room's temperature and repeat; if it stays, run celadon calibrate",
              check.difference_mm, check.normalised_error, check.U_mm, check.U_reference_mm));
  const double form = std::max(0., measured->form_mm - reference.form_mm) / std::max(check.form_expected_mm, 1e-9);
  judge(
      check, form, l.form_good, l.form_usable,
      text_of("the surface deviates from a %s by %.4f mm, where %.4f mm are certified and %.4f mm expected; clean the "
              "reference and set it up firmly; if it stays, run celadon calibrate",
              to_string(reference.shape), measured->form_mm, reference.form_mm, check.form_expected_mm));
  judge(
      check, check.U_mm / reference.diameter_mm, l.coarse_good, l.coarse_usable,
      text_of("the scanner's own uncertainty of %.3f mm (k = 2) is %.2f %% of the diameter, too much to tell anything "
              "finer; calibrate with a board that was measured better",
              check.U_mm, 100 * check.U_mm / reference.diameter_mm));
  if (!check.failed_checks.empty()) {
    std::string names;
    for (const std::string& name : check.failed_checks) names += (names.empty() ? "" : ", ") + name;
    judge(check, 1, 0, 0, "the scan failed its own checks (" + names + "); see to these first");
  }
  return check;
}

std::string format_check(const ReferenceCheck& check, const nlohmann::json& report) {
  using Json = nlohmann::ordered_json;
  const Reference& r = check.reference;
  const ReferenceLimits& l = check.limits;
  const auto from_report = [&](const char* name) { return report.contains(name) ? Json(report[name]) : Json(nullptr); };
  const Json json{
      {"format", "celadon-check"},
      {"version", 1},
      {"units", {{"length", "mm"}}},
      {"name", from_report("name")},
      {"date", from_report("date")},
      {"machine", from_report("machine")},
      {"simulated", from_report("simulated")},
      {"calibration_date", report["calibration"].value("date", "")},
      {"reference",
       {{"shape", to_string(r.shape)},
        {"diameter_mm", r.diameter_mm},
        {"standard_uncertainty_mm", r.u_mm},
        {"form_mm", r.form_mm},
        {"expansion_per_K", r.expansion_per_K},
        {"temperature_C", r.temperature_C},
        {"temperature_standard_uncertainty_K", r.temperature_u_K},
        {"diameter_then_mm", r.diameter_then_mm()},
        {"expanded_uncertainty_mm", check.U_reference_mm}}},
      {"measured",
       {{"model", from_report("model")},
        {"diameter_mm", check.measured.diameter_mm},
        {"form_mm", check.measured.form_mm},
        {"form_expected_mm", check.form_expected_mm},
        {"radius_standard_uncertainty_fit_mm", check.measured.fit_u_mm},
        {"radius_standard_uncertainty_calibration_mm", check.calibration_u_mm},
        {"expanded_uncertainty_mm", check.U_mm}}},
      {"difference_mm", check.difference_mm},
      {"normalised_error", std::isfinite(check.normalised_error) ? Json(check.normalised_error) : Json(nullptr)},
      {"limits",
       {{"normalised_error", {l.error_good, l.error_usable}},
        {"form_over_expected", {l.form_good, l.form_usable}},
        {"relative_uncertainty", {l.coarse_good, l.coarse_usable}}}},
      {"failed_checks", check.failed_checks},
      {"verdict", to_string(check.verdict)},
      {"findings", check.findings}};
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace celadon
