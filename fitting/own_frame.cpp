#include "fitting/own_frame.h"

#include <Eigen/Dense>
#include <cmath>
#include <numbers>
#include <utility>

namespace celadon {
namespace {

constexpr std::size_t kPoints = 12000;
// Of the points that local_frame() saw, so many lie on the shape it found.
constexpr double kInliers = 0.8;
constexpr int kHeights = 32, kAngles = 128;

bool is_round(SurfaceModel model) {
  return model == SurfaceModel::cylinder || model == SurfaceModel::revolution;
}

// Some of the look's samples, evenly, in the scanner's frame.
Eigen::Matrix3Xd points_of(const FirstLook& look) {
  const auto& samples = look.samples();
  const std::size_t step = std::max<std::size_t>(1, samples.size() / kPoints),
                    count = (samples.size() + step - 1) / step;
  const BaseArcs& arcs = look.specification().arcs;
  Eigen::Matrix3Xd points(3, static_cast<Eigen::Index>(count));
  for (std::size_t k = 0; k < count; ++k) {
    const SamplePoint& s = samples[k * step];
    const double theta = arcs.theta_of_v(s.v);
    points.col(static_cast<Eigen::Index>(k)) << s.r_mm * std::cos(theta), s.r_mm * std::sin(theta), s.z_mm;
  }
  return points;
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
  MomentGrid sums(*grid);
  FirstLook look(sums);
  all.rewind();
  while (const Profile* profile = all.next()) {
    sums.add(profile->r_mm, profile->theta_rad, profile->z_mm);
    look.add(*profile);
  }
  auto surface = fit_surface(sums, look, moved.streams(), options, executor);
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

}  // namespace

std::optional<OwnFrameFit> fit_in_own_frame(const SurfaceFit& in_scanner_frame, const FirstLook& look,
                                            ProfileParts parts, const RangeFitOptions& options,
                                            const Executor& executor) {
  if (options.model != SurfaceModel::automatic || options.base != BaseKind::cylinder || !options.arcs.closed() ||
      is_round(in_scanner_frame.fit.report.model))
    return std::nullopt;
  auto frame = local_frame(points_of(look));
  if (!frame || frame->shape == FrameShape::elliptic || frame->inliers < kInliers) return std::nullopt;
  // Heights stay those over the table.
  const Eigen::Vector3d o = frame->X_SL.translation(), k = frame->X_SL.linear().col(2);
  if (k.z() > 0) frame->X_SL.translation() = o - k * (o.z() / k.z());
  auto own = refit(frame->X_SL, parts, options, executor);
  if (own && !is_round(own->surface.fit.report.model)) {
    frame->X_SL = frame->X_SL * axis_of(own->surface.fit.function);
    own = refit(frame->X_SL, parts, options, executor);
  }
  if (!own || !is_round(own->surface.fit.report.model)) return std::nullopt;
  RangeFit& fit = own->surface.fit;
  const RangeFunction& f = fit.function;
  BaseSurface base = f.base();
  base.X_WB = frame->X_SL;
  fit.function = RangeFunction(base, f.degree_u(), f.degree_v(), f.knots_u(), f.knots_v(), f.coefficients());
  fit.surface = symbolic_product(fit.function);
  return OwnFrameFit{std::move(*frame), std::move(own->surface), std::move(own->samples)};
}

}  // namespace celadon
