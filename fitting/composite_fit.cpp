#include "fitting/composite_fit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <string>
#include <utility>

#include "fitting/fit_report.h"
#include "fitting/spherical_stream.h"
#include "fitting/window_stream.h"

namespace celadon {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity(), kEquator = 1;
// Pieces that met worse than this many of their noise's standard deviations, or this angle, are worth a word.
constexpr double kGapScales = 1, kAngleRad = 0.02;

/// The samples of one piece, read anew at every pass.
class Piece {
 public:
  Piece(ProfileStream& samples, const char* name, BaseKind base, double centre_mm, double lowest_mm, double highest_mm)
      : name_(name),
        base_(base),
        centre_mm_(centre_mm),
        window_(samples, lowest_mm, highest_mm),
        spherical_(window_, centre_mm) {}
  Piece(const Piece&) = delete;
  Piece& operator=(const Piece&) = delete;

  const char* name() const { return name_; }
  ProfileStream& stream() { return base_ == BaseKind::sphere ? static_cast<ProfileStream&>(spherical_) : window_; }

  /// The piece by itself; its surface reaches the splits.
  tl::expected<SurfaceFit, FitError> fit(RangeFitOptions options, const CompositeSplit& split) {
    options.base = base_;
    const auto named = [&](const FitError& error) { return tl::unexpected(FitError{name_ + (": " + error.message)}); };
    auto grid = choose_grid(stream(), options);
    if (!grid) return named(grid.error());
    if (base_ == BaseKind::cylinder) {
      options.reach_start = split.below_mm;
      options.reach_end = split.above_mm;
      grid->z_start_mm = split.below_mm.value_or(grid->z_start_mm);
      grid->z_end_mm = split.above_mm.value_or(grid->z_end_mm);
    } else {
      (split.above_mm == centre_mm_ ? options.reach_end : options.reach_start) = kEquator;
    }
    const GatheredSamples gathered = gather(stream(), *grid);
    ProfileStream* const whole[] = {&stream()};
    auto fitted = fit_surface(gathered.sums, gathered.look, whole, options);
    if (!fitted) return named(fitted.error());
    if (base_ == BaseKind::sphere) {
      const RangeFunction& f = fitted->fit.function;
      BaseSurface base = f.base();
      base.X_WB.translation().z() = centre_mm_;
      fitted->fit.function =
          RangeFunction(base, f.degree_u(), f.degree_v(), f.knots_u(), f.knots_v(), f.coefficients());
    }
    return fitted;
  }

 private:
  const char* name_;
  BaseKind base_;
  double centre_mm_;
  WindowStream window_;
  SphericalStream spherical_;
};

void describe_joined(RangeFit& fit) {
  fit.surface = symbolic_product(fit.function);
  fit.report.degree_u = fit.surface.degree_u;
  fit.report.degree_v = fit.surface.degree_v;
  fit.report.control_points_u = fit.surface.count_u();
  fit.report.control_points_v = fit.surface.count_v();
  const bool u = fit.function.degree_u() > 0, v = fit.function.degree_v() > 0;
  fit.report.model = u   ? (v ? SurfaceModel::general : SurfaceModel::revolution)
                     : v ? SurfaceModel::translational
                         : SurfaceModel::cylinder;
}

std::optional<FitError> refuse(const CompositeSplit& split, const RangeFitOptions& options) {
  if (!split.below_mm && !split.above_mm)
    return FitError{"a composite needs a height at which it is split; name one, or fit a cylinder or a sphere"};
  if (split.below_mm && split.above_mm && !(*split.below_mm < *split.above_mm))
    return FitError{text("the lower split at %.6g mm is not below the upper one at %.6g mm; exchange them",
                         *split.below_mm, *split.above_mm)};
  if (!options.arcs.closed())
    return FitError{"composites are closed around; fit the open range as a cylinder or a sphere"};
  if (options.degree_u < 2)
    return FitError{text("the degree %d along the pieces has no tangents to share; take 2 or more", options.degree_u)};
  return std::nullopt;
}

}  // namespace

tl::expected<CompositeFit, FitError> fit_composite(ProfileStream& samples, const CompositeSplit& split,
                                                   const RangeFitOptions& options) {
  if (auto error = refuse(split, options)) return tl::unexpected(*error);
  const double below = split.below_mm.value_or(-kInfinity), above = split.above_mm.value_or(kInfinity);
  std::vector<std::unique_ptr<Piece>> pieces;
  if (split.below_mm)
    pieces.push_back(std::make_unique<Piece>(samples, "the head below", BaseKind::sphere, below, -kInfinity,
                                             std::nextafter(below, -kInfinity)));
  const std::size_t body = pieces.size();
  pieces.push_back(std::make_unique<Piece>(samples, "the body", BaseKind::cylinder, 0, below, above));
  if (split.above_mm)
    pieces.push_back(std::make_unique<Piece>(samples, "the head above", BaseKind::sphere, above,
                                             std::nextafter(above, kInfinity), kInfinity));

  std::vector<SurfaceFit> fits;
  for (const auto& piece : pieces) {
    auto fit = piece->fit(options, split);
    if (!fit) return tl::unexpected(fit.error());
    fits.push_back(std::move(*fit));
  }
  CompositeFit composite;
  for (std::size_t k = 0; k < fits.size(); ++k)
    if (k != body)
      composite.joints.push_back({.height_mm = k < body ? below : above,
                                  .top = k > body,
                                  .before = meeting(fits[body].fit.function, fits[k].fit.function),
                                  .after = {}});
  // Between two heads twice: the second may give the body knots around that the first has not.
  for (int round = 0; round < (fits.size() == 3 ? 2 : 1); ++round)
    for (std::size_t k = 0; k < fits.size(); ++k) {
      if (k == body) continue;
      auto joined = join(fits[body].fit.function, fits[k].fit.function, options.continuity);
      fits[body].fit.function = std::move(joined.body);
      fits[k].fit.function = std::move(joined.head);
    }
  for (CompositeJoint& joint : composite.joints)
    joint.after = meeting(fits[body].fit.function, fits[joint.top ? fits.size() - 1 : 0].fit.function);

  RangeFitReport& all = composite.report;
  SurfaceErrors missed;
  for (std::size_t k = 0; k < fits.size(); ++k) {
    describe_joined(fits[k].fit);
    ProfileStream* const whole[] = {&pieces[k]->stream()};
    SurfaceErrors of_piece;
    RangeFit fit = measure_errors(std::move(fits[k]), whole, run_in_turn, &of_piece);
    missed.merge(of_piece);
    all.points += fit.report.points;
    all.rejected += fit.report.rejected;
    all.unfollowable += fit.report.unfollowable;
    for (const std::string& warning : fit.report.warnings)
      all.warnings.push_back(std::string(pieces[k]->name()) + ": " + warning);
    composite.pieces.push_back(std::move(fit));
  }
  all.residual_mm = missed.along_ray_mm();
  all.geometric_mm = missed.geometric_mm();
  double noise_square = 0, counted = 0;
  for (const RangeFit& piece : composite.pieces) {
    const auto n = static_cast<double>(piece.report.points - piece.report.rejected - piece.report.unfollowable);
    noise_square += n * piece.report.noise_mm * piece.report.noise_mm;
    all.coverage += n * piece.report.coverage;
    all.kappa = std::max(all.kappa, piece.report.kappa);
    counted += n;
  }
  all.noise_mm = std::sqrt(noise_square / std::max(counted, 1.0));
  all.coverage /= std::max(counted, 1.0);
  for (const CompositeJoint& joint : composite.joints)
    if (joint.before.gap_mm > kGapScales * all.noise_mm + 1e-9 * joint.height_mm || joint.before.angle_rad > kAngleRad)
      all.warnings.push_back(
          text("at z = %.4g mm the pieces met within %.3g mm and %.2f degrees before they were joined; if the object "
               "has an edge there, it is rounded off.",
               joint.height_mm, joint.before.gap_mm, joint.before.angle_rad * 180 / std::numbers::pi));
  return composite;
}

}  // namespace celadon
