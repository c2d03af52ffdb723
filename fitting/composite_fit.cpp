#include "fitting/composite_fit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <string>
#include <utility>

#include "fitting/coefficient_covariance.h"
#include "fitting/fit_report.h"
#include "fitting/joined_deviation.h"
#include "fitting/moved_stream.h"
#include "fitting/spherical_stream.h"
#include "fitting/window_stream.h"

namespace celadon {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity(), kEquator = 1;
// Pieces that met worse than this many of their noise's standard deviations, or this angle, are worth a word.
constexpr double kGapScales = 1, kAngleRad = 0.02;

/// Where a piece ends: at a height that it reaches, and its samples so far from it. The wall further in may lie in the
/// shadow of the shoulder, which is no longer than the shoulder is wide.
struct PieceEnd {
  std::optional<double> height_mm;
  double edge_mm = 0, shadow_mm = 0;
};

/// The samples of one piece, read anew at every pass.
class Piece {
 public:
  /// A wall of the body.
  Piece(ProfileParts samples, std::string name, const PieceEnd& low, const PieceEnd& high)
      : name_(std::move(name)), low_(low), high_(high) {
    add_windows(samples, low.height_mm ? *low.height_mm + low.edge_mm : -kInfinity,
                high.height_mm ? *high.height_mm - high.edge_mm : kInfinity);
  }
  /// A head about the axis' point at that height.
  Piece(ProfileParts samples, bool top, double centre_mm)
      : name_(top ? "the head above" : "the head below"), head_(true), centre_mm_(centre_mm), top_(top) {
    add_windows(samples, top ? std::nextafter(centre_mm, kInfinity) : -kInfinity,
                top ? kInfinity : std::nextafter(centre_mm, -kInfinity));
  }
  Piece(const Piece&) = delete;
  Piece& operator=(const Piece&) = delete;

  const std::string& name() const { return name_; }
  bool head() const { return head_; }
  bool top() const { return top_; }
  double centre_mm() const { return centre_mm_; }
  ProfileParts parts() const { return parts_; }

  /// The piece by itself; its surface reaches the heights at its ends.
  tl::expected<SurfaceFit, FitError> fit(RangeFitOptions options, const Executor& executor) {
    options.base = head_ ? BaseKind::sphere : BaseKind::cylinder;
    const auto named = [&](const FitError& error) { return tl::unexpected(FitError{name_ + ": " + error.message}); };
    options.reach_start = options.reach_end = std::nullopt;
    JoinedStream all(parts_);
    auto grid = choose_grid(all, options);
    if (!grid) return named(grid.error());
    if (head_) {
      (top_ ? options.reach_end : options.reach_start) = kEquator;
    } else {
      options.reach_start = low_.height_mm;
      options.reach_end = high_.height_mm;
      options.hidden_start = low_.shadow_mm;
      options.hidden_end = high_.shadow_mm;
      grid->z_start_mm = low_.height_mm.value_or(grid->z_start_mm);
      grid->z_end_mm = high_.height_mm.value_or(grid->z_end_mm);
    }
    const GatheredSamples gathered = gather(parts_, *grid, executor);
    auto fitted = fit_surface(gathered.sums, gathered.look, parts_, options, executor);
    if (!fitted) return named(fitted.error());
    if (head_) {
      const RangeFunction& f = fitted->fit.function;
      BaseSurface base = f.base();
      base.X_WB.translation().z() = centre_mm_;
      fitted->fit.function =
          RangeFunction(base, f.degree_u(), f.degree_v(), f.knots_u(), f.knots_v(), f.coefficients());
    }
    return fitted;
  }

 private:
  void add_windows(ProfileParts samples, double lowest_mm, double highest_mm) {
    for (ProfileStream* part : samples) {
      streams_.push_back(std::make_unique<WindowStream>(*part, lowest_mm, highest_mm));
      if (head_) streams_.push_back(std::make_unique<SphericalStream>(*streams_.back(), centre_mm_));
      parts_.push_back(streams_.back().get());
    }
  }

  std::string name_;
  PieceEnd low_, high_;
  std::vector<std::unique_ptr<ProfileStream>> streams_;
  std::vector<ProfileStream*> parts_;
  bool head_ = false;
  double centre_mm_ = 0;
  bool top_ = false;
};

/// From bottom to top.
std::vector<std::unique_ptr<Piece>> pieces_of(ProfileParts samples, const CompositeSplit& split,
                                              const RangeFitOptions& options) {
  std::vector<PieceEnd> ends = {{split.below_mm ? split.below_mm : options.reach_start, 0}};
  for (const Shoulder& shoulder : split.shoulders) {
    // A sample at the very height of a shoulder lies on no wall.
    ends.push_back({shoulder.height_mm, std::max(shoulder.edge_mm, 1e-12 * std::abs(shoulder.height_mm) + 1e-12),
                    std::abs(shoulder.jump_mm)});
  }
  ends.push_back({split.above_mm ? split.above_mm : options.reach_end, 0});
  std::vector<std::unique_ptr<Piece>> pieces;
  if (split.below_mm) pieces.push_back(std::make_unique<Piece>(samples, false, *split.below_mm));
  for (std::size_t k = 0; k + 1 < ends.size(); ++k) {
    const auto &low = ends[k], &high = ends[k + 1];
    std::string name = "the body";
    if (!split.shoulders.empty())
      name = "the wall" + (low.height_mm ? text(" from %.6g mm", *low.height_mm) : "") +
             (high.height_mm ? text(" up to %.6g mm", *high.height_mm) : "");
    pieces.push_back(std::make_unique<Piece>(samples, std::move(name), low, high));
  }
  if (split.above_mm) pieces.push_back(std::make_unique<Piece>(samples, true, *split.above_mm));
  return pieces;
}

/// Two walls whose rims cross leave no ring between them.
std::optional<FitError> crossing(const Shoulder& shoulder, const RangeFunction& below, const RangeFunction& above) {
  constexpr int kAngles = 1440;
  double least = kInfinity, most = -kInfinity, there = 0;
  for (int k = 0; k < kAngles; ++k) {
    const double theta = 2 * std::numbers::pi * k / kAngles;
    const double jump = above(theta, shoulder.height_mm) - below(theta, shoulder.height_mm);
    if (shoulder.jump_mm > 0 ? jump < least : jump > most) there = theta;
    least = std::min(least, jump);
    most = std::max(most, jump);
  }
  if (least > 0 || most < 0) return std::nullopt;
  return FitError{text(
      "the walls below and above z = %.6g mm cross near %.0f degrees: there is no ring between them; name the height "
      "of the shoulder, or fit the walls one by one between two heights",
      shoulder.height_mm, there * 180 / std::numbers::pi)};
}

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

/// A wall and the head that was joined to it.
struct JoinedRim {
  std::size_t wall, head;
  bool top;
  double height_mm;
  BodyShare of_body;
};

void state_deviations(std::vector<RangeFit>& pieces, const std::vector<JoinedRim>& rims) {
  std::vector<std::optional<CoefficientCovariance>> alone;
  alone.reserve(pieces.size());
  for (const RangeFit& piece : pieces)
    alone.push_back(piece.errors ? CoefficientCovariance::of(*piece.errors) : std::nullopt);
  for (std::size_t k = 0; k < pieces.size(); ++k) {
    std::vector<JoinedEnd> ends;
    bool known = alone[k].has_value();
    for (const JoinedRim& rim : rims) {
      if (rim.wall != k && rim.head != k) continue;
      const auto& other = alone[rim.wall == k ? rim.head : rim.wall];
      known = known && other.has_value();
      if (!known) break;
      // A head's meridian runs downward: the rim of one on top is its end.
      ends.push_back({rim.top, &*other, rim.wall == k ? kEquator : rim.height_mm, rim.of_body});
    }
    if (!known) continue;
    const BaseSurface& base = pieces[k].function.base();
    const DeviationMap& map =
        pieces[k].deviation.emplace(ends.empty() ? deviation_map(*alone[k], base.band_start, base.band_end)
                                                 : joined_deviation(*alone[k], pieces[k].function, ends));
    pieces[k].report.sd_mean_mm = map.mean(base);
    pieces[k].report.sd_max_mm = map.largest();
  }
}

std::optional<FitError> refuse(const CompositeSplit& split, const RangeFitOptions& options) {
  if (!split.any())
    return FitError{"a composite needs a height at which it is split; name one, or fit a cylinder or a sphere"};
  std::vector<double> heights;
  if (split.below_mm) heights.push_back(*split.below_mm);
  for (const Shoulder& shoulder : split.shoulders) heights.push_back(shoulder.height_mm);
  if (split.above_mm) heights.push_back(*split.above_mm);
  for (std::size_t k = 1; k < heights.size(); ++k)
    if (!(heights[k - 1] < heights[k]))
      return FitError{
          text("the split at %.6g mm is not below the next one at %.6g mm; exchange them", heights[k - 1], heights[k])};
  if (!options.arcs.closed())
    return FitError{"composites are closed around; fit the open range as a cylinder or a sphere"};
  if (options.degree_u < 2 && (split.below_mm || split.above_mm))
    return FitError{text("the degree %d along the pieces has no tangents to share; take 2 or more", options.degree_u)};
  return std::nullopt;
}

}  // namespace

tl::expected<CompositeFit, FitError> fit_composite(ProfileStream& samples, const CompositeSplit& split,
                                                   const RangeFitOptions& options) {
  ProfileStream* const whole[] = {&samples};
  return fit_composite(whole, split, options, run_in_turn);
}

tl::expected<CompositeFit, FitError> fit_composite(ProfileParts samples, const CompositeSplit& split,
                                                   const RangeFitOptions& options, const Executor& executor) {
  if (auto error = refuse(split, options)) return tl::unexpected(*error);
  const auto pieces = pieces_of(samples, split, options);
  std::vector<SurfaceFit> fits;
  for (const auto& piece : pieces) {
    auto fit = piece->fit(options, executor);
    if (!fit) return tl::unexpected(fit.error());
    fits.push_back(std::move(*fit));
  }
  CompositeFit composite;
  composite.shoulders = split.shoulders;
  const std::size_t first_wall = split.below_mm ? 1 : 0;
  for (std::size_t k = 0; k < split.shoulders.size(); ++k)
    if (auto error =
            crossing(split.shoulders[k], fits[first_wall + k].fit.function, fits[first_wall + k + 1].fit.function))
      return tl::unexpected(*error);

  // The wall that a head joins is its neighbour.
  const auto wall_at = [&](std::size_t head) { return pieces[head]->top() ? head - 1 : head + 1; };
  const auto wall_of = [&](std::size_t head) -> RangeFunction& { return fits[wall_at(head)].fit.function; };
  std::vector<BodyShare> shares(fits.size());  // of heads
  std::vector<std::size_t> heads;
  for (std::size_t k = 0; k < pieces.size(); ++k)
    if (pieces[k]->head()) heads.push_back(k);
  for (const std::size_t head : heads)
    composite.joints.push_back({.height_mm = pieces[head]->centre_mm(),
                                .top = pieces[head]->top(),
                                .before = meeting(wall_of(head), fits[head].fit.function),
                                .after = {}});
  // One wall between two heads twice: the second may give it knots around that the first has not.
  for (int round = 0; round < (heads.size() == 2 && fits.size() == 3 ? 2 : 1); ++round)
    for (const std::size_t head : heads) {
      auto joined = join(wall_of(head), fits[head].fit.function, options.continuity);
      wall_of(head) = std::move(joined.body);
      fits[head].fit.function = std::move(joined.head);
      if (round == 0) shares[head] = joined.of_body;  // later rounds find one rim
    }
  for (std::size_t k = 0; k < heads.size(); ++k)
    composite.joints[k].after = meeting(wall_of(heads[k]), fits[heads[k]].fit.function);

  std::vector<JoinedRim> rims;
  for (const std::size_t head : heads)
    rims.push_back({wall_at(head), head, pieces[head]->top(), pieces[head]->centre_mm(), shares[head]});
  RangeFitReport& all = composite.report;
  SurfaceErrors missed;
  for (std::size_t k = 0; k < fits.size(); ++k) {
    describe_joined(fits[k].fit);
    SurfaceErrors of_piece;
    const auto sources = std::move(fits[k].fit.errors);  // deviations follow when all pieces are known
    RangeFit fit = measure_errors(std::move(fits[k]), pieces[k]->parts(), executor, &of_piece);
    fit.errors = sources;
    missed.merge(of_piece);
    all.points += fit.report.points;
    all.rejected += fit.report.rejected;
    all.unfollowable += fit.report.unfollowable;
    for (const std::string& warning : fit.report.warnings) all.warnings.push_back(pieces[k]->name() + ": " + warning);
    composite.pieces.push_back(std::move(fit));
  }
  state_deviations(composite.pieces, rims);
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
