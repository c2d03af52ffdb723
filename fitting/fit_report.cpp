#include "fitting/fit_report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <limits>
#include <numbers>
#include <utility>

#include "fitting/model_selection.h"

namespace celadon {
namespace {

// Standard deviations from which a constraint is worth a warning.
constexpr double kContradicted = 4;

}  // namespace

std::string text(const char* format, ...) {
  std::array<char, 500> buffer;
  std::va_list values;
  va_start(values, format);
  std::vsnprintf(buffer.data(), buffer.size(), format, values);
  va_end(values);
  return buffer.data();
}

const char* to_string(SurfaceModel model, BaseKind base) {
  switch (model) {
    case SurfaceModel::cylinder:
      return base == BaseKind::sphere ? "sphere" : "cylinder";
    case SurfaceModel::revolution:
      return "revolution";
    case SurfaceModel::translational:
      return "translational";
    case SurfaceModel::general:
      return "general";
    case SurfaceModel::automatic:
      break;
  }
  return "auto";
}

std::optional<FitError> refuse(const MomentGrid& sums, const RangeFitOptions& options) {
  const auto& grid = sums.specification();
  if (options.degree_u < 1 || options.degree_u > grid.degree_u || options.degree_v < 1 ||
      options.degree_v > grid.degree_v)
    return FitError{text("the degrees (%d, %d) are outside 1..(%d, %d), what the sums were made for", options.degree_u,
                         options.degree_v, grid.degree_u, grid.degree_v)};
  if (options.z_intervals.has_value() != options.intervals_per_arc.has_value())
    return FitError{"fixed numbers of intervals must be given for both directions or for none"};
  if (options.constraints.any() && options.base == BaseKind::sphere)
    return FitError{"radii and angles can be held over a cylinder only; leave them out, or fit a cylinder"};
  if (auto error = refuse(options.constraints)) return error;
  if (sums.samples() == 0 && sums.rejected() == 0)
    return FitError{"there are no samples; scan the object or name another input"};
  if (sums.samples() > 0) return std::nullopt;
  if (sums.rejected_on_axis() >= std::max(sums.rejected_not_finite(), sums.rejected_outside()))
    return FitError{
        text("all %zu samples lie on the axis (r = 0); check the axis and the units", sums.rejected_on_axis())};
  if (sums.rejected_not_finite() >= sums.rejected_outside())
    return FitError{text("none of the %zu samples is a finite number; check the input's format", sums.rejected())};
  return FitError{text("all %zu samples lie outside the band from z = %.6g to %.6g mm; widen the band", sums.rejected(),
                       grid.z_start_mm, grid.z_end_mm)};
}

std::optional<FitError> refuse(const CoveredBand& band, bool whole_turn) {
  const bool nothing_covered = band.sectors_with_samples == 0 || band.cells.first >= band.cells.last;
  if (nothing_covered && band.base == BaseKind::sphere)
    return FitError{
        text("no polar angle has samples all around (%d of %d sectors have any); scan the whole turn, or check "
             "the axis and the centre",
             band.sectors_with_samples, band.sectors)};
  if (nothing_covered)
    return FitError{
        text("no height between z = %.6g and %.6g mm has samples all around (%d of %d sectors have any); scan the "
             "whole turn, or check the axis",
             band.lowest_mm, band.highest_mm, band.sectors_with_samples, band.sectors)};
  if (whole_turn && 2 * band.sectors_with_samples < band.sectors)
    return FitError{
        text("only %d of %d sectors around the axis have samples; scan at least half of the turn, or fit "
             "the part that was scanned",
             band.sectors_with_samples, band.sectors)};
  return std::nullopt;
}

std::optional<FitError> refuse_too_few(const MomentGrid& sums, const FitLadder& ladder,
                                       const RangeFitOptions& options) {
  const bool forced = options.model != SurfaceModel::automatic;
  const Variation variation = forced ? variation_of(options.model) : Variation{};
  const bool fixed = options.z_intervals.has_value();
  const int unknowns = fixed ? ladder.unknowns(0, 0, variation)
                             : ladder.unknowns(ladder.levels_u() - 1, ladder.levels_v() - 1, variation);
  if (sums.samples() >= static_cast<std::size_t>(unknowns)) return std::nullopt;
  return FitError{text("%zu samples are fewer than the %d unknowns of the %s %s surface; take more samples%s",
                       sums.samples(), unknowns, fixed ? "requested" : "smallest",
                       to_string(forced ? options.model : SurfaceModel::general),
                       fixed ? " or ask for fewer intervals" : " or ask for a simpler shape")};
}

std::optional<FitError> refuse_crossing(const RangeFunction& function) {
  if (function.coefficients().minCoeff() > 0) return std::nullopt;  // a mean of coefficients is positive then
  constexpr int kPerCoefficient = 6;
  const BaseSurface& base = function.base();
  const auto around = function.coefficients().cols() * kPerCoefficient,
             along = function.coefficients().rows() * kPerCoefficient;
  double least = std::numeric_limits<double>::infinity(), at_theta = 0, at_z = 0;
  for (Eigen::Index i = 0; i <= along; ++i)
    for (Eigen::Index j = 0; j <= around; ++j) {
      const double f = static_cast<double>(i) / static_cast<double>(along);
      const double z = (1 - f) * base.band_start + f * base.band_end;
      const double v = base.arcs.count() * static_cast<double>(j) / static_cast<double>(around);
      const double theta = base.arcs.theta_of_v(v);
      if (const double r = function(theta, z); r < least) least = r, at_theta = theta, at_z = z;
    }
  if (least > 0) return std::nullopt;
  if (base.spherical())
    return FitError{
        text("the surface would reach the centre at phi = %.0f, theta = %.0f degrees, where the samples jump or are "
             "missing; cut off what is not of the object, scan what is missing, or name another centre",
             BaseSurface::meridian().theta_of_v(at_z) * 180 / std::numbers::pi, at_theta * 180 / std::numbers::pi)};
  return FitError{
      text("the surface would cross the axis at z = %.4g mm, theta = %.0f degrees, where the samples jump or are "
           "missing; cut off "
           "what is not of the object (a platter, a stand) or scan what is missing",
           at_z, at_theta * 180 / std::numbers::pi)};
}

void describe(RangeFit& fit, const CoveredBand& band, const MomentGrid& sums) {
  RangeFitReport& report = fit.report;
  report.degree_u = fit.surface.degree_u;
  report.degree_v = fit.surface.degree_v;
  report.control_points_u = fit.surface.count_u();
  report.control_points_v = fit.surface.count_v();
  report.cut_below_mm = std::max(0.0, band.z_start_mm - band.lowest_mm);
  report.cut_above_mm = std::max(0.0, band.highest_mm - band.z_end_mm);
  if (fit.function.base().spherical()) {  // from above to below, in parts of the meridian
    const BaseArcs& meridian = BaseSurface::meridian();
    const double unit_mm = meridian.arc_rad() * fit.function.coefficients().mean();
    report.phi_start_rad = meridian.theta_of_v(band.z_start_mm);
    report.phi_end_rad = meridian.theta_of_v(band.z_end_mm);
    std::swap(report.cut_below_mm, report.cut_above_mm);
    report.cut_below_mm *= unit_mm;
    report.cut_above_mm *= unit_mm;
  } else {
    report.z_start_mm = band.z_start_mm;
    report.z_end_mm = band.z_end_mm;
  }
  report.coverage = covered_share(sums, band);
}

void warn(RangeFit& fit, const CoveredBand& band) {
  RangeFitReport& report = fit.report;
  const auto share = [&](std::size_t n) {
    return 100.0 * static_cast<double>(n) / static_cast<double>(std::max<std::size_t>(report.points, 1));
  };
  const bool spherical = fit.function.base().spherical();
  const double height = spherical ? (report.phi_end_rad - report.phi_start_rad) * fit.function.coefficients().mean()
                                  : report.z_end_mm - report.z_start_mm;
  if (band.sectors_with_samples < band.sectors)
    report.warnings.push_back(
        text("%d of %d sectors around the axis have no samples over most of the height; the surface bridges them.",
             band.sectors - band.sectors_with_samples, band.sectors));
  if (report.coverage < 0.95)
    report.warnings.push_back(
        text("%.1f %% of the surface has no samples and is bridged.", 100 * (1 - report.coverage)));
  if (report.unfollowable > 0)
    report.warnings.push_back(
        text("%zu samples (%.2f %%) lie on handles or undercuts that no single-valued surface can follow; they were "
             "left out.",
             report.unfollowable, share(report.unfollowable)));
  if (share(report.rejected) > 1)
    report.warnings.push_back(text("%zu samples (%.2f %%) were rejected as outliers or not usable.", report.rejected,
                                   share(report.rejected)));
  for (const HeldConstraint& held : report.constraints)
    if (std::abs(held.alone - held.asked) > kContradicted * held.alone_sd)
      report.warnings.push_back(text("The samples contradict what is held, %s: by themselves they have %.6g %s there.",
                                     held.what.c_str(), held.alone * (held.is_angle ? 180 / std::numbers::pi : 1),
                                     held.is_angle ? "degrees" : "mm"));
  for (const WallStep& step : report.steps)
    report.warnings.push_back(text(
        "The wall steps by %.3g mm at z = %.4g mm: no smooth surface follows that, and this one swings about the wall "
        "near it. Fit what lies between the steps by itself.",
        std::abs(step.jump_mm), step.z_mm));
  if (report.cut_below_mm > 0.005 * height)
    report.warnings.push_back(
        text("%.3g mm at the lower rim were measured but not all around, and are cut.", report.cut_below_mm));
  if (report.cut_above_mm > 0.005 * height)
    report.warnings.push_back(
        text("%.3g mm at the upper rim were measured but not all around, and are cut.", report.cut_above_mm));
}

}  // namespace celadon
