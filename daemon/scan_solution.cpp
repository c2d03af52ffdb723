#include "daemon/scan_solution.h"

#include <algorithm>
#include <cstdio>
#include <limits>
#include <utility>

#include "daemon/shape_fit.h"
#include "daemon/thread_executor.h"
#include "fitting/moved_stream.h"
#include "fitting/own_frame.h"

namespace celadon {
namespace {

// More samples than this share off the band that was fixed before the scan: fix it again from the log.
constexpr double kMostOffBand = 1e-3;

tl::unexpected<ScanStop> unsolved(const std::string& reason, ScanFailure failure = ScanFailure::system) {
  return tl::make_unexpected(ScanStop{ScanState::failed, reason, false, false, failure});
}

SurfaceModel model_of(const std::string& text) {
  for (const auto model :
       {SurfaceModel::cylinder, SurfaceModel::revolution, SurfaceModel::translational, SurfaceModel::general}) {
    if (text == to_string(model)) return model;
  }
  return SurfaceModel::automatic;
}

/// Fixes the band again where too many samples lie outside, from the log.
tl::expected<void, ScanStop> widen_band(const std::filesystem::path& file, const RangeFitOptions& options,
                                        MomentGrid& sums, FirstLook& look) {
  const auto all = static_cast<double>(sums.samples() + sums.rejected());
  if (static_cast<double>(sums.rejected()) <= kMostOffBand * all) return {};
  auto log = ProfileLogReader::open(file);
  if (!log) return unsolved(log.error().message);
  auto grid = choose_grid(**log, options);
  if (!grid) return unsolved(grid.error().message, ScanFailure::data);
  GatheredSamples gathered = gather(**log, *grid);
  sums = std::move(gathered.sums);
  look = std::move(gathered.look);
  if (!(*log)->error().empty()) return unsolved((*log)->error());
  return {};
}

/// Spherical samples about the crossing of the axes, unless the object does not hold it: a ray from there would meet
/// the surface twice or never.
void centre_at(double crossing_z_mm, ProfileStream& samples, ShapeChoice& shape, ResultNotes& notes) {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  samples.rewind();
  while (const Profile* const profile = samples.next()) {
    if (profile->z_mm.empty()) continue;
    const auto [least, most] = std::minmax_element(profile->z_mm.begin(), profile->z_mm.end());
    low = std::min(low, *least);
    high = std::max(high, *most);
  }
  // A tenth of the height away from both ends: rays nearly along the surface measure nothing.
  constexpr double kMargin = 0.1;
  const double margin_mm = kMargin * (high - low);
  if (crossing_z_mm > low + margin_mm && crossing_z_mm < high - margin_mm) {
    shape.centre_z_mm = crossing_z_mm;
    return;
  }
  char text[240];
  std::snprintf(
      text, sizeof text,
      "The axes of table and head cross at z = %.1f mm, not well inside the object, which reaches from %.1f to "
      "%.1f mm: its spherical samples are about z = %.1f mm of the table's axis.",
      crossing_z_mm, low, high, shape.centre_z_mm);
  notes.warnings.emplace_back(text);
}

}  // namespace

tl::expected<LogParts, ScanStop> LogParts::open(const std::filesystem::path& file, const ProfileLogWriter& log) {
  constexpr int kParts = 4;
  const std::vector<RecordMark> edges = log.divide(kParts);
  LogParts parts;
  for (std::size_t k = 0; k + 1 < edges.size(); ++k) {
    auto reader = ProfileLogReader::open(file, edges[k], edges[k + 1]);
    if (!reader) return unsolved(reader.error().message);
    parts.streams_.push_back(reader->get());
    parts.readers_.push_back(std::move(*reader));
  }
  return parts;
}

RangeFitOptions fit_options(const ScanRequest& request, const Calibration& calibration) {
  RangeFitOptions options;
  options.model = model_of(request.model);
  options.degree_u = request.degree_u;
  options.degree_v = request.degree_v;
  options.tolerance_mm = request.tolerance_mm;
  options.form_tolerance_mm = request.form_tolerance_mm;
  options.systematic_mm = calibration.systematic_mm;
  return options;
}

tl::expected<SolvedBody, ScanStop> solve_wall(const std::filesystem::path& file, const RangeFitOptions& options,
                                              MomentGrid& sums, FirstLook& look, const LogParts& log,
                                              ResultNotes& notes) {
  if (auto widened = widen_band(file, options, sums, look); !widened) return tl::make_unexpected(widened.error());
  auto surface = fit_surface(sums, look, log.streams(), options, run_on_all_cores);
  if (const std::string error = log.error(); !error.empty()) return unsolved(error);
  if (!surface) return unsolved("No surface was found: " + surface.error().message, ScanFailure::data);
  auto own = fit_in_own_frame(*surface, look, log.streams(), options, run_on_all_cores);
  if (const std::string error = log.error(); !error.empty()) return unsolved(error);
  if (own) {
    notes.about_scanner_axis = surface->fit.report;
    notes.own_axis = own->frame;
    notes.warnings.insert(notes.warnings.end(), own->frame.warnings.begin(), own->frame.warnings.end());
    *surface = std::move(own->surface);
  }
  SolvedBody body{{{surface->fit.function, surface->fit.surface}}, surface->fit.report.noise_mm, {}};
  const auto measure = [&log](SurfaceFit fitted, auto moved) -> tl::expected<BodyFit, ResultError> {
    RangeFit fit = measure_errors(std::move(fitted), moved ? moved->streams() : log.streams(), run_on_all_cores);
    if (const std::string error = log.error(); !error.empty()) return tl::make_unexpected(ResultError{4, error});
    BodyFit whole;  // g++ 12 takes a variant that is moved from a temporary one for uninitialised
    whole.fit = std::move(fit);
    return whole;
  };
  using Moved = std::optional<decltype(own->samples)>;
  body.measured =
      std::async(std::launch::async, measure, std::move(*surface), own ? Moved(std::move(own->samples)) : Moved());
  return body;
}

tl::expected<SolvedBody, ScanStop> solve_shape(const std::string& name, const RangeFitOptions& options,
                                               const LogParts& log, std::optional<double> centre_z_mm,
                                               ResultNotes& notes) {
  const ProfileParts parts = log.streams();
  JoinedStream all(parts);
  auto shape = shape_named(name, all);
  if (shape && shape->shape == BodyShape::sphere && centre_z_mm) centre_at(*centre_z_mm, all, *shape, notes);
  FitSetting setting;
  setting.off_centre_rule = true;
  setting.lap = [](const char*) {};
  auto fit = shape ? fit_shape(*shape, all, parts, options, setting, notes) : tl::make_unexpected(shape.error());
  if (const std::string error = log.error(); !error.empty()) return unsolved(error);
  if (!fit) return unsolved("No surface was found: " + fit.error(), ScanFailure::data);
  notes.shape_reason = shape->reason;
  SolvedBody body;
  for (const RangeFit& piece : fit->pieces()) body.pieces.push_back({piece.function, piece.surface});
  body.noise_mm = fit->whole().noise_mm;
  std::promise<tl::expected<BodyFit, ResultError>> measured;
  body.measured = measured.get_future();
  measured.set_value(std::move(*fit));
  return body;
}

}  // namespace celadon
