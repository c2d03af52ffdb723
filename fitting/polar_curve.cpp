#include "fitting/polar_curve.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "fitting/bspline_basis.h"

namespace celadon {
namespace {

// The cylinder over a curve is as high as this share of its radius, so flat that no cell of the sums is cut along it;
// its samples lie at heights of the golden ratio, which no angles follow.
constexpr double kHeightShare = 1e-3;

/// Points of the plane as samples of the cylinder over them.
class CylinderOver : public ProfileStream {
 public:
  explicit CylinderOver(const Eigen::Matrix2Xd& points) {
    const double height = kHeightShare * points.colwise().norm().mean();
    profile_.order = ProfileOrder::scattered;
    double share = 0;
    for (const auto& p : points.colwise()) {
      const double theta = std::atan2(p.y(), p.x());
      share = std::fmod(share + std::numbers::phi - 1, 1.0);
      profile_.r_mm.push_back(p.norm());
      profile_.theta_rad.push_back(theta < 0 ? theta + 2 * std::numbers::pi : theta);
      profile_.z_mm.push_back(height * share);
    }
  }
  void rewind() override { read_ = false; }
  const Profile* next() override { return std::exchange(read_, true) ? nullptr : &profile_; }

 private:
  Profile profile_;
  bool read_ = false;
};

// A section of the exact surface across its axis: its first row of control points.
NurbsCurve section_of(const NurbsSurface& surface) {
  NurbsCurve curve{surface.degree_v, surface.knots_v, Eigen::Matrix3Xd(3, surface.count_v()), surface.closed_v};
  for (int j = 0; j < surface.count_v(); ++j) {
    const Eigen::Vector4d p = surface.control_point(0, j);
    curve.control_points.col(j) << p.x(), p.y(), p.w();
  }
  return curve;
}

}  // namespace

Eigen::Vector2d NurbsCurve::evaluate(double v) const {
  return derivatives(v).C;
}

CurveDerivatives NurbsCurve::derivatives(double v) const {
  v = std::clamp(v, knots.front(), knots.back());
  const int span = find_span(knots, degree, v);
  const auto N = basis_derivatives(knots, degree, span, v);
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();  // columns: derivatives of the homogeneous curve
  for (int j = 0; j <= degree; ++j)
    for (int b = 0; b < 3; ++b)
      H.col(b) += N[static_cast<std::size_t>(b)][static_cast<std::size_t>(j)] * control_points.col(span - degree + j);
  CurveDerivatives d;
  d.C = H.col(0).head<2>() / H(2, 0);
  d.C_v = (H.col(1).head<2>() - H(2, 1) * d.C) / H(2, 0);
  d.C_vv = (H.col(2).head<2>() - 2 * H(2, 1) * d.C_v - H(2, 2) * d.C) / H(2, 0);
  return d;
}

tl::expected<CurveFit, FitError> fit_curve(const Eigen::Matrix2Xd& points, const CurveFitOptions& options) {
  if (points.cols() == 0) return tl::unexpected(FitError{"there are no points; give some"});
  CylinderOver samples(points);
  RangeFitOptions range;
  range.degree_u = 1;
  range.degree_v = options.degree;
  range.arcs = options.arcs;
  range.tolerance_mm = options.tolerance_mm;
  range.form_tolerance_mm = options.form_tolerance_mm;
  range.robust = options.robust;
  range.smoothing = options.smoothing;
  if (options.intervals_per_arc) {
    range.z_intervals = 1;
    range.intervals_per_arc = options.intervals_per_arc;
  }
  auto fit = fit_samples(samples, range);
  if (!fit) return tl::unexpected(fit.error());
  const bool circle = fit->report.model == SurfaceModel::cylinder;
  const std::string decided_by = fit->report.decided_by;
  if (!circle && fit->report.model != SurfaceModel::translational) {
    // Nothing varies with the heights that the points were given.
    range.model = SurfaceModel::translational;
    fit = fit_samples(samples, range);
    if (!fit) return tl::unexpected(fit.error());
  }
  CurveFit result;
  result.curve = section_of(fit->surface);
  result.circle = circle;
  result.coefficients = fit->function.coefficients().row(0).transpose();
  if (!circle) result.knots = fit->function.knots_v();
  result.points = static_cast<int>(fit->report.points);
  result.rejected = static_cast<int>(fit->report.rejected + fit->report.unfollowable);
  result.noise_mm = fit->report.noise_mm;
  result.radial_mm = fit->report.residual_mm;
  result.perpendicular_mm = fit->report.geometric_mm;
  result.decided_by = decided_by;
  result.warnings = fit->report.warnings;
  return result;
}

}  // namespace celadon
