#include "fitting/own_frame.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "fitting/even_points.h"
#include "fitting/look_stream.h"

namespace celadon {
namespace {

constexpr std::size_t kPoints = 12000;
// Sections that miss circles by more of their radius, RMS, are not those of a round body that leans a little.
constexpr double kMostOfRadius = 0.01;
// Of the points that local_frame() saw, so many lie on the shape it found.
constexpr double kInliers = 0.6;
constexpr int kHeights = 32, kAngles = 128;

// Sections of a round body across an axis beside its own are circles, and nearly so if it leans.
bool sections_are_circles(const RangeFunction& f) {
  const BaseSurface& base = f.base();
  double square = 0, radius = 0;
  for (int i = 0; i < kHeights; ++i) {
    const double z = base.band_start + (base.band_end - base.band_start) * (i + 0.5) / kHeights;
    // x^2 + y^2 = 2 a x + 2 b y + c
    Eigen::Matrix<double, kAngles, 3> place;
    Eigen::Matrix<double, kAngles, 1> wanted;
    for (int j = 0; j < kAngles; ++j) {
      const double theta = 2 * std::numbers::pi * j / kAngles, r = f(theta, z);
      place.row(j) << 2 * r * std::cos(theta), 2 * r * std::sin(theta), 1;
      wanted(j) = r * r;
    }
    const Eigen::Vector3d circle = (place.transpose() * place).ldlt().solve(place.transpose() * wanted);
    const double R = std::sqrt(std::max(0.0, circle(2) + circle.head<2>().squaredNorm()));
    for (int j = 0; j < kAngles; ++j) {
      const double miss = (place.row(j).head<2>().transpose() / 2 - circle.head<2>()).norm() - R;
      square += miss * miss / (kHeights * kAngles);
    }
    radius += R / kHeights;
  }
  return std::sqrt(square) < kMostOfRadius * radius;
}

struct Refit {
  SurfaceFit surface;
  MovedParts samples;
};

std::optional<Refit> refit(const Eigen::Isometry3d& X_SL, ProfileParts parts, const RangeFitOptions& options,
                           const Executor& executor) {
  MovedParts moved(parts, X_SL.inverse());
  JoinedStream all(moved.streams());
  const auto grid = choose_grid(all, options);
  if (!grid) return std::nullopt;
  const GatheredSamples gathered = gather(all, *grid);
  auto surface = fit_surface(gathered.sums, gathered.look, moved.streams(), options, executor);
  if (!surface) return std::nullopt;
  return Refit{std::move(*surface), std::move(moved)};
}

// Where the axis of a nearly round surface really is, in the surface's frame. A shift d and a tilt t of it leave the
// first harmonic d + t (z + R R') in the range.
Eigen::Isometry3d axis_of(const RangeFunction& f) {
  const BaseSurface& base = f.base();
  Eigen::Matrix2d normal = Eigen::Matrix2d::Zero(), right = normal;
  for (int i = 0; i < kHeights; ++i) {
    const double z = base.band_start + (base.band_end - base.band_start) * (i + 0.5) / kHeights;
    Eigen::RowVector2d harmonic(0, 0);
    double R = 0, R_z = 0;
    for (int j = 0; j < kAngles; ++j) {
      const double theta = 2 * std::numbers::pi * j / kAngles;
      const RangeDerivatives at = f.derivatives(theta, z);
      harmonic += 2 * at.r_mm * Eigen::RowVector2d(std::cos(theta), std::sin(theta)) / kAngles;
      R += at.r_mm / kAngles;
      R_z += at.r_z / kAngles;
    }
    const Eigen::Vector2d lever(1, z + R * R_z);
    normal += lever * lever.transpose();
    right += lever * harmonic;
  }
  const Eigen::Matrix2d shift_and_tilt = normal.ldlt().solve(right);  // columns: x, y
  const Eigen::Vector3d k = Eigen::Vector3d(shift_and_tilt(1, 0), shift_and_tilt(1, 1), 1).normalized();
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.translation() << shift_and_tilt(0, 0), shift_and_tilt(0, 1), 0;
  X.linear() = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), k).toRotationMatrix();
  return X;
}

// The fit about that axis, and about what its first harmonic says the axis is, if one of them is round.
std::optional<Refit> round_about(Eigen::Isometry3d& X_SL, ProfileParts parts, const RangeFitOptions& options,
                                 const Executor& executor) {
  auto fit = refit(X_SL, parts, options, executor);
  if (fit && !is_round(fit->surface.fit.report.model)) {
    X_SL = X_SL * axis_of(fit->surface.fit.function);
    fit = refit(X_SL, parts, options, executor);
  }
  if (fit && !is_round(fit->surface.fit.report.model)) fit.reset();
  return fit;
}

}  // namespace

bool is_round(SurfaceModel model) {
  return model == SurfaceModel::cylinder || model == SurfaceModel::revolution;
}

std::optional<Eigen::Isometry3d> axis_of_sections(const RangeFunction& surface) {
  const BaseSurface& base = surface.base();
  if (base.spherical() || base.heights || !base.arcs.closed() || !sections_are_circles(surface)) return std::nullopt;
  return axis_of(surface);
}

std::optional<OwnFrameFit> fit_in_own_frame(const SurfaceFit& in_scanner_frame, const FirstLook& look,
                                            ProfileParts parts, const RangeFitOptions& options,
                                            const Executor& executor) {
  if (options.model != SurfaceModel::automatic || options.base != BaseKind::cylinder || !options.arcs.closed() ||
      is_round(in_scanner_frame.fit.report.model))
    return std::nullopt;
  if (!sections_are_circles(in_scanner_frame.fit.function)) return std::nullopt;
  LookStream some(look);
  auto frame = local_frame(even_points(some, kPoints));
  if (!frame || frame->shape == FrameShape::elliptic || frame->inliers < kInliers) return std::nullopt;
  // Heights stay those over the table.
  const Eigen::Vector3d o = frame->X_SL.translation(), k = frame->X_SL.linear().col(2);
  if (k.z() > 0) frame->X_SL.translation() = o - k * (o.z() / k.z());
  // On the sample first: it knows the axis better than local_frame(), and is quick to say no.
  ProfileStream* const sample[] = {&some};
  RangeFitOptions general = options;
  general.model = SurfaceModel::general;
  if (const auto fit = refit(frame->X_SL, sample, general, executor))
    frame->X_SL = frame->X_SL * axis_of(fit->surface.fit.function);
  if (!round_about(frame->X_SL, sample, options, executor)) return std::nullopt;
  auto own = round_about(frame->X_SL, parts, options, executor);
  if (!own) return std::nullopt;
  RangeFit& fit = own->surface.fit;
  const RangeFunction& f = fit.function;
  BaseSurface base = f.base();
  base.X_WB = frame->X_SL;
  fit.function = RangeFunction(base, f.degree_u(), f.degree_v(), f.knots_u(), f.knots_v(), f.coefficients());
  fit.surface = symbolic_product(fit.function);
  return OwnFrameFit{std::move(*frame), std::move(own->surface), std::move(own->samples)};
}

}  // namespace celadon
