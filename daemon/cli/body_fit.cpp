#include "daemon/cli/body_fit.h"

#include <algorithm>
#include <utility>

#include "daemon/cli/fit_outputs.h"
#include "fitting/own_frame.h"
#include "fitting/spherical_stream.h"
#include "fitting/symmetry.h"

namespace celadon::cli {
namespace {

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

}  // namespace

std::span<const RangeFit> BodyFit::pieces() const {
  if (const auto* one = std::get_if<RangeFit>(&fit)) return {one, 1};
  return std::get<CompositeFit>(fit).pieces;
}

nlohmann::ordered_json BodyFit::report(const ResultNotes& notes) const {
  return std::visit([&](const auto& of) { return report_json(of, notes); }, fit);
}

const RangeFit* BodyFit::wall() const {
  const auto all = pieces();
  const auto found =
      std::find_if(all.begin(), all.end(), [](const RangeFit& piece) { return !piece.function.base().spherical(); });
  return found == all.end() ? nullptr : &*found;
}

bool BodyFit::wall_is_round() const {
  return wall() != nullptr && is_round(wall()->report.model);
}

std::optional<Eigen::Isometry3d> BodyFit::better_axis() const {
  return wall() == nullptr || wall_is_round() ? std::nullopt : axis_of_sections(wall()->function);
}

tl::expected<BodyFit, std::string> fit_shape(const ShapeChoice& shape, ProfileStream& samples, RangeFitOptions options,
                                             const FitSetting& setting, ResultNotes& notes) {
  if (shape.shape == BodyShape::composite) {
    auto composite = fit_composite(samples, shape.split, options);
    if (!composite) return tl::make_unexpected(composite.error().message);
    for (RangeFit& piece : composite->pieces) place(piece, setting.X_WL);
    setting.lap("fit");
    return BodyFit{std::move(*composite)};
  }
  if (setting.symmetry.any()) return fit_symmetric_body(samples, options, setting, notes);
  SphericalStream spherical(samples, shape.centre_z_mm);
  const bool sphere = shape.shape == BodyShape::sphere;
  ProfileStream& stream = sphere ? static_cast<ProfileStream&>(spherical) : samples;
  options.base = sphere ? BaseKind::sphere : BaseKind::cylinder;
  const auto grid = choose_grid(stream, options);
  if (!grid) return tl::make_unexpected(grid.error().message);
  setting.lap("read");
  const GatheredSamples gathered = gather(stream, *grid);
  setting.lap("accumulate");
  ProfileStream* const whole[] = {&stream};
  auto surface = fit_surface(gathered.sums, gathered.look, whole, options);
  if (!surface) return tl::make_unexpected(surface.error().message);
  if (auto own = setting.off_centre_rule ? fit_in_own_frame(*surface, gathered.look, whole, options) : std::nullopt) {
    notes.about_scanner_axis = surface->fit.report;
    notes.own_axis = own->frame;
    notes.warnings.insert(notes.warnings.end(), own->frame.warnings.begin(), own->frame.warnings.end());
    setting.lap("axis");
    return BodyFit{measure_errors(std::move(own->surface), own->samples.streams())};
  }
  RangeFit fitted = measure_errors(std::move(*surface), whole);
  Eigen::Isometry3d X_WB = setting.X_WL;
  if (sphere) X_WB.translate(Eigen::Vector3d(0, 0, shape.centre_z_mm));
  if (!X_WB.matrix().isIdentity(0)) place(fitted, X_WB);
  setting.lap("fit");
  return BodyFit{std::move(fitted)};
}

}  // namespace celadon::cli
