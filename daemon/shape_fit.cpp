#include "daemon/shape_fit.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <utility>
#include <vector>

#include "daemon/thread_executor.h"
#include "fitting/even_points.h"
#include "fitting/flat_ends.h"
#include "fitting/moved_stream.h"
#include "fitting/own_frame.h"
#include "fitting/rims.h"
#include "fitting/spherical_stream.h"
#include "fitting/symmetry.h"

namespace celadon {
namespace {

constexpr std::size_t kFlatPoints = 24000;
constexpr double kMuch = 0.02;  // of the height, cut at a rim

// One sector of the body from all samples, and the whole of it from that.
tl::expected<RangeFit, FitError> fit_symmetric(ProfileStream& samples, const Symmetry& symmetry,
                                               RangeFitOptions options) {
  FoldedStream folded(samples, symmetry);
  options.arcs = symmetry.sector();
  auto sector = fit_samples(folded, options);
  if (!sector) return sector;
  return unfolded(std::move(*sector), symmetry);
}

tl::expected<BodyFit, std::string> fit_symmetric_body(ProfileStream& samples, const RangeFitOptions& options,
                                                      const FitSetting& setting, ResultNotes& notes) {
  Symmetry symmetry{.fold = setting.symmetry.fold, .mirrored = false, .plane_rad = 0};
  if (setting.symmetry.mirrored && !setting.symmetry.plane_rad) {
    const auto without = fit_symmetric(samples, symmetry, options);
    if (!without) return tl::make_unexpected(without.error().message);
    const auto plane = find_mirror_plane(without->function, symmetry.fold);
    if (!plane) return tl::make_unexpected(plane.error().message);
    symmetry.plane_rad = *plane;
    setting.lap("mirror");
  }
  symmetry.mirrored = setting.symmetry.mirrored;
  if (setting.symmetry.plane_rad) symmetry.plane_rad = *setting.symmetry.plane_rad;
  auto fitted = fit_symmetric(samples, symmetry, options);
  if (!fitted) return tl::make_unexpected(fitted.error().message);
  if (!setting.X_WL.matrix().isIdentity(0)) place(*fitted, setting.X_WL);
  notes.symmetry = symmetry;
  setting.lap("fit");
  return BodyFit{std::move(*fitted)};
}

tl::expected<BodyFit, std::string> fit_wall(const ShapeChoice& shape, ProfileStream& samples, ProfileParts parts,
                                            RangeFitOptions options, const FitSetting& setting, ResultNotes& notes) {
  if (shape.shape == BodyShape::composite) {
    auto composite = fit_composite(parts, shape.split, options, run_on_all_cores);
    if (!composite) return tl::make_unexpected(composite.error().message);
    for (RangeFit& piece : composite->pieces) place(piece, setting.X_WL);
    setting.lap("fit");
    return BodyFit{std::move(*composite)};
  }
  if (setting.symmetry.any()) return fit_symmetric_body(samples, options, setting, notes);
  const bool sphere = shape.shape == BodyShape::sphere;
  std::shared_ptr<const RangeFunction> heights;
  if (setting.follow_rims) {
    auto rims = find_rims(samples, options);
    if (!rims) return tl::make_unexpected(rims.error().message);
    heights = rims->heights;
    char text[160];
    std::snprintf(
        text, sizeof text,
        "The rims follow the ends of the samples, which scatter by %.2g mm below and %.2g mm above; %.1f %% of "
        "the samples lie beyond them.",
        rims->lower_scatter_mm, rims->upper_scatter_mm, 100 * rims->share_beyond);
    notes.warnings.push_back(text);
    setting.lap("rims");
  }
  std::vector<std::unique_ptr<ProfileStream>> on_base;
  std::vector<ProfileStream*> whole(parts.begin(), parts.end());
  for (ProfileStream*& part : whole) {
    if (sphere) on_base.push_back(std::make_unique<SphericalStream>(*part, shape.centre_z_mm));
    if (heights) on_base.push_back(std::make_unique<RimmedStream>(*part, heights));
    if (sphere || heights) part = on_base.back().get();
  }
  JoinedStream stream(whole);
  options.base = sphere ? BaseKind::sphere : BaseKind::cylinder;
  const auto grid = choose_grid(stream, options);
  if (!grid) return tl::make_unexpected(grid.error().message);
  setting.lap("read");
  const GatheredSamples gathered = gather(whole, *grid, run_on_all_cores);
  setting.lap("accumulate");
  auto surface = fit_surface(gathered.sums, gathered.look, whole, options, run_on_all_cores);
  if (!surface) return tl::make_unexpected(surface.error().message);
  if (heights) put_between_rims(surface->fit, heights);
  if (auto own = setting.off_centre_rule && !heights
                     ? fit_in_own_frame(*surface, gathered.look, whole, options, run_on_all_cores)
                     : std::nullopt) {
    notes.about_scanner_axis = surface->fit.report;
    notes.own_axis = own->frame;
    notes.warnings.insert(notes.warnings.end(), own->frame.warnings.begin(), own->frame.warnings.end());
    setting.lap("axis");
    return BodyFit{measure_errors(std::move(own->surface), own->samples.streams(), run_on_all_cores)};
  }
  RangeFit fitted = measure_errors(std::move(*surface), whole, run_on_all_cores);
  Eigen::Isometry3d X_WB = setting.X_WL;
  if (sphere) X_WB.translate(Eigen::Vector3d(0, 0, shape.centre_z_mm));
  if (!X_WB.matrix().isIdentity(0)) place(fitted, X_WB);
  const double cut_mm = std::max(fitted.report.cut_below_mm, fitted.report.cut_above_mm);
  if (!sphere && !heights && cut_mm > kMuch * (fitted.report.z_end_mm - fitted.report.z_start_mm))
    notes.warnings.push_back("If the object ends on a rim that is not plane, --rims follow keeps what was cut.");
  if (!fitted.report.steps.empty())
    notes.warnings.push_back("--shape auto makes walls with plane shoulders between them of it.");
  setting.lap("fit");
  return BodyFit{std::move(fitted)};
}

}  // namespace

tl::expected<ShapeChoice, std::string> shape_named(const std::string& name, ProfileStream& samples) {
  ShapeChoice named;
  if (name == "cylinder") return named;
  if (name == "sphere") {
    named.shape = BodyShape::sphere;
    named.centre_z_mm = centre_on_axis_mm(samples);
    if (!std::isfinite(named.centre_z_mm))
      return tl::make_unexpected("the samples lie at one height and show no centre; name one with --centre-z");
    return named;
  }
  auto choice = name == "composite" ? choose_shape(samples, BodyShape::composite) : choose_shape(samples);
  if (!choice) return tl::make_unexpected(choice.error().message);
  return *choice;
}

tl::expected<BodyFit, std::string> fit_shape(const ShapeChoice& shape, ProfileStream& samples, ProfileParts parts,
                                             RangeFitOptions options, const FitSetting& setting, ResultNotes& notes) {
  notes.flat_ends = find_flat_ends(even_points(samples, kFlatPoints));
  setting.lap("faces");
  const FlatEnds& ends = notes.flat_ends;
  if (!ends.any()) return fit_wall(shape, samples, parts, options, setting, notes);
  std::vector<std::unique_ptr<WallStream>> walls;
  std::vector<ProfileStream*> wall_parts;
  for (ProfileStream* part : parts)
    wall_parts.push_back(walls.emplace_back(std::make_unique<WallStream>(*part, ends)).get());
  JoinedStream wall(wall_parts);
  if (shape.shape == BodyShape::sphere || setting.follow_rims)
    return fit_wall(shape, wall, wall_parts, options, setting, notes);
  // The wall goes on to its faces; where it does not, it ends where its samples do.
  RangeFitOptions to_faces = options;
  if (ends.lower && !shape.split.below_mm) to_faces.reach_start = ends.lower->height_mm;
  if (ends.upper && !shape.split.above_mm) to_faces.reach_end = ends.upper->height_mm;
  auto fitted = fit_wall(shape, wall, wall_parts, to_faces, setting, notes);
  if (fitted) return fitted;
  const std::string why = fitted.error();
  fitted = fit_wall(shape, wall, wall_parts, options, setting, notes);
  if (fitted) notes.warnings.push_back("The wall does not go on to the flat faces that were found: " + why + ".");
  return fitted;
}

}  // namespace celadon
