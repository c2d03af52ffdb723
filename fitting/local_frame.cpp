#include "fitting/local_frame.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>
#include <optional>
#include <variant>
#include <vector>

#include "fitting/line_geometry.h"
#include "fitting/quadric.h"
#include "fitting/quadric_axes.h"
#include "fitting/robust_least_squares.h"
#include "fitting/round_shapes.h"
#include "fitting/surface_sample.h"

namespace celadon {
namespace {

constexpr int kFewest = 50;
constexpr int kRacers = 1500;          // points that starts are compared on
constexpr double kRounding = 1e-9;     // of the size: shapes are not told apart below
constexpr double kAsGood = 1.05;       // of the lowest cost: a form deviation of 0.22 standard deviations
constexpr std::ptrdiff_t kSlice = 24;  // points on one circle, nearly
constexpr double kSure = 3;            // standard deviations

std::string number(double value, const char* format = "%.3g") {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), format, value);
  return text.data();
}
double degrees(double rad) {
  return rad * 180 / std::numbers::pi;
}

using Shape = std::variant<Sphere, Cone, MeridianSurface>;

struct Fitted {
  Shape shape;
  FrameShape kind = FrameShape::revolution;
  RobustSolution solution;
  Eigen::VectorXd residuals;
  int unknowns() const {
    return std::visit([](const auto& s) { return s.unknowns(); }, shape);
  }
};

// The points that decide, their weights and the rounding of their coordinates.
struct Data {
  Eigen::Matrix3Xd points;
  Eigen::VectorXd weights;
  double least_scale = 0;    // of the fits: rounding of the coordinates
  double told_apart_mm = 0;  // of the choice: deviations below say nothing
};

Data thinned(const Data& all, Eigen::Index most) {
  const Eigen::Index N = all.points.cols(), M = std::min(N, most);
  Data some{Eigen::Matrix3Xd(3, M), Eigen::VectorXd(M), all.least_scale, all.told_apart_mm};
  for (Eigen::Index k = 0; k < M; ++k) {
    some.points.col(k) = all.points.col(k * N / M);
    some.weights[k] = all.weights[k * N / M];
  }
  return some;
}

template <class S>
Fitted refined(S shape, FrameShape kind, const Data& data) {
  Fitted fitted;
  fitted.kind = kind;
  fitted.solution = fit_robustly(shape, data.points, data.weights, data.least_scale);
  fitted.residuals.resize(data.points.cols());
  shape.residuals(data.points, fitted.residuals, nullptr);
  fitted.shape = std::move(shape);
  return fitted;
}

MeridianSurface with_degree(const MeridianSurface& from, Eigen::Index degree, bool elliptic) {
  MeridianSurface surface = from;
  const Eigen::Index kept = std::min(degree + 1, from.coefficients.size());
  surface.coefficients = Eigen::VectorXd::Zero(degree + 1);
  surface.coefficients.head(kept) = from.coefficients.head(kept);
  surface.elliptic = elliptic;
  return surface;
}

// The smallest scale among the fits, and the costs at that scale: comparable, and no stray counts more than another.
std::vector<double> costs_of(const std::vector<Fitted>& fits, const Data& data) {
  double scale = std::numeric_limits<double>::infinity();
  for (const Fitted& fit : fits)
    if (fit.residuals.allFinite() && fit.solution.scale > 0) scale = std::min(scale, fit.solution.scale);
  std::vector<double> costs;
  costs.reserve(fits.size());
  for (const Fitted& fit : fits) {
    costs.push_back(fit.residuals.allFinite() && std::isfinite(scale)
                        ? tukey_cost(fit.residuals, data.weights, std::max(scale, data.told_apart_mm))
                        : std::numeric_limits<double>::infinity());
  }
  return costs;
}

struct Start {
  AxisFrame axis;
  AxisStart from = AxisStart::none;
};

AxisFrame axis_along(const Eigen::Vector3d& k, const Eigen::Vector3d& point) {
  return {frame_along(k, Eigen::Vector3d::UnitX()), point};
}

// Axes that may be the right one. A quadric's centre far beside the points, where noise alone has put it, is replaced
// by that of the circle through the points seen along the axis.
std::vector<Start> starts_of(const SurfaceSample& sample, const std::optional<QuadricFit>& quadric,
                             const std::optional<QuadricAxes>& axes, double size) {
  std::vector<Start> starts;
  const auto add = [&](AxisStart from, const Eigen::Vector3d& k, const Eigen::Vector3d& point) {
    AxisFrame axis = axis_along(k, point);
    const Cone circle = cylinder_through(sample.points, sample.weights, k);
    Eigen::Vector3d across = axis.local(circle.axis.point_mm);
    across.z() = 0;
    if (!(across.norm() <= 3 * size)) axis.point_mm = circle.axis.point_mm;
    starts.push_back({axis, from});
  };
  if (quadric && axes) {
    const std::size_t tried = axes->reason == AxisReason::comparable_gaps ? 3 : 1;
    for (std::size_t n = 0; n < tried; ++n)
      add(AxisStart::quadric, axes->frames[n].axes.col(2), axes->frames[n].origin_mm);
  }
  if (const auto lines =
          rotation_axis(sample.middles, sample.normals,
                        {sample.normal_weights.data(), static_cast<std::size_t>(sample.normal_weights.size())})) {
    add(AxisStart::line_geometry, lines->direction, lines->point_mm);
  }
  const Eigen::Matrix3d spread = sample.normals * sample.normal_weights.asDiagonal() * sample.normals.transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(spread);
  const Eigen::Vector3d k = solver.eigenvectors().col(0);
  add(AxisStart::normals, k, cylinder_through(sample.points, sample.weights, k).axis.point_mm);
  return starts;
}

// The best surface of revolution from any start, on fewer points.
std::pair<MeridianSurface, AxisStart> race(const std::vector<Start>& starts, const Data& data) {
  std::vector<Fitted> fits;
  std::vector<AxisStart> from;
  for (const Start& start : starts) {
    const MeridianSurface surface = meridian_through(data.points, data.weights, start.axis, 4);
    // A cylinder has an easier way down, and polynomials from a tilted start may close around the tilt.
    Cone tube = cylinder_through(data.points, data.weights, start.axis.axes.col(2));
    Fitted cylinder = refined(tube, FrameShape::cylinder, data);
    fits.push_back(refined(surface, FrameShape::revolution, data));
    fits.push_back(refined(meridian_through(data.points, data.weights, std::get<Cone>(cylinder.shape).axis, 4),
                           FrameShape::revolution, data));
    from.insert(from.end(), 2, start.from);
  }
  const std::vector<double> costs = costs_of(fits, data);
  const auto best = static_cast<std::size_t>(std::min_element(costs.begin(), costs.end()) - costs.begin());
  return {std::get<MeridianSurface>(fits[best].shape), from[best]};
}

std::vector<Fitted> candidates(const MeridianSurface& best, const Data& data) {
  std::vector<Fitted> fits;
  fits.push_back(refined(sphere_through(data.points, data.weights), FrameShape::sphere, data));
  Cone cone = cylinder_through(data.points, data.weights, best.axis.axes.col(2));
  cone.axis = best.axis;
  const double h = best.half_band_mm, middle = std::max(0.0, best.coefficients[0] - best.coefficients[2]);
  cone.radius_mm = std::sqrt(middle);
  cone.cylinder = true;
  fits.push_back(refined(cone, FrameShape::cylinder, data));
  cone.cylinder = false;
  cone.slope = middle > 0 ? best.coefficients[1] / (2 * cone.radius_mm * h) : 0;
  fits.push_back(refined(cone, FrameShape::cone, data));
  const MeridianSurface fresh = meridian_through(data.points, data.weights, best.axis, 8);
  for (const bool elliptic : {false, true})
    for (const Eigen::Index degree : {2, 4, 8})
      fits.push_back(refined(with_degree(degree == 8 ? fresh : best, degree, elliptic),
                             elliptic ? FrameShape::elliptic : FrameShape::revolution, data));
  return fits;
}

// Where the axis is and how well it is known there.
void place_on_axis(const Fitted& chosen, const AxisFrame& axis, const std::optional<QuadricFit>& quadric,
                   const std::optional<QuadricAxes>& axes, const Data& data, LocalFrame& frame) {
  const auto* meridian = std::get_if<MeridianSurface>(&chosen.shape);
  Eigen::Vector3d short_axis = Eigen::Vector3d::UnitX();
  if (chosen.kind == FrameShape::elliptic) {
    Eigen::Matrix2d sections;
    sections << 1 + meridian->a, meridian->b, meridian->b, 1 - meridian->a;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> solver(sections);
    short_axis = axis.axes.leftCols<2>() * solver.eigenvectors().col(1);
  }
  frame.X_SL.linear() = frame_along(axis.axes.col(2), short_axis);

  double low = std::numeric_limits<double>::infinity(), high = -low, mean = 0;
  for (Eigen::Index n = 0; n < data.points.cols(); ++n) {
    if (std::abs(chosen.residuals[n]) > 4.685 * chosen.solution.scale || !(data.weights[n] > 0)) continue;
    const double z = axis.local(data.points.col(n)).z();
    low = std::min(low, z), high = std::max(high, z);
  }
  const Eigen::Vector3d centroid = data.points * data.weights / data.weights.sum();
  mean = axis.local(centroid).z();
  double height = std::clamp(mean, low, high);
  // A centre along the axis: of the refined meridian where it is a quadratic with one, beyond its noise.
  if (quadric && axes && meridian && meridian->coefficients.size() == 3 && chosen.solution.covariance.size() > 0) {
    // P = c0 + c1 s + c2 (2 s^2 - 1): stationary at s = -c1/(4 c2).
    const double c1 = meridian->coefficients[1], c2 = meridian->coefficients[2];
    const Eigen::Matrix2d cov = chosen.solution.covariance.block<2, 2>(5, 5);
    const double s = -c1 / (4 * c2);
    const Eigen::Vector2d slope(-1 / (4 * c2), c1 / (4 * c2 * c2));
    const double sd = std::sqrt(std::max(0.0, slope.dot(cov * slope))) * meridian->half_band_mm;
    const double at = s * meridian->half_band_mm;
    if (std::abs(c2) > kSure * std::sqrt(std::max(0.0, cov(1, 1))) && at > low && at < high &&
        kSure * sd < 0.05 * (high - low))
      height = at;
  }
  frame.X_SL.translation() = axis.point_mm + height * axis.axes.col(2);

  if (chosen.solution.covariance.size() == 0) {
    frame.axis_sd_rad = frame.origin_sd_mm = std::numeric_limits<double>::infinity();
    return;
  }
  const auto larger = [](const Eigen::Matrix2d& covariance) {
    return std::sqrt(std::max(0.0, covariance.selfadjointView<Eigen::Lower>().eigenvalues()[1]));
  };
  const Eigen::Matrix4d cov = chosen.solution.covariance.topLeftCorner<4, 4>();
  frame.axis_sd_rad = larger(cov.topLeftCorner<2, 2>());
  // A turn by (p, q) moves the axis at this height by height (q, -p).
  Eigen::Matrix<double, 2, 4> lever;
  lever << 0, height, 1, 0, -height, 0, 0, 1;
  frame.origin_sd_mm = larger(lever * cov * lever.transpose());
}

// Share of the points that lie on circles about the axis with those at nearly their height: of a stepped shaft, whose
// meridian no polynomial follows, all.
double share_round(const Data& data, const AxisFrame& axis, double scatter_mm) {
  struct Place {
    double h, rho;
  };
  std::vector<Place> places;
  for (Eigen::Index n = 0; n < data.points.cols(); ++n) {
    if (!(data.weights[n] > 0)) continue;
    const Eigen::Vector3d local = axis.local(data.points.col(n));
    places.push_back({local.z(), local.head<2>().norm()});
  }
  std::sort(places.begin(), places.end(), [](const Place& a, const Place& b) { return a.h < b.h; });
  const auto slices = static_cast<std::ptrdiff_t>(places.size()) / kSlice;
  std::vector<double> middles;
  for (std::ptrdiff_t s = 0; s < slices; ++s) {
    std::vector<double> rho;
    for (std::ptrdiff_t k = s * kSlice; k < (s + 1) * kSlice; ++k)
      rho.push_back(places[static_cast<std::size_t>(k)].rho);
    std::nth_element(rho.begin(), rho.begin() + kSlice / 2, rho.end());
    middles.push_back(rho[kSlice / 2]);
  }
  double round = 0;
  for (std::ptrdiff_t s = 1; s + 1 < slices; ++s) {
    const auto at = static_cast<std::size_t>(s);
    // What both neighbours go on with is the slice's own slope, not a step.
    const double after = middles[at + 1] - middles[at], before = middles[at] - middles[at - 1];
    const double rise = after * before > 0 ? std::min(std::abs(after), std::abs(before)) : 0;
    for (std::ptrdiff_t k = s * kSlice; k < (s + 1) * kSlice; ++k)
      round += std::abs(places[static_cast<std::size_t>(k)].rho - middles[at]) <= 4.685 * scatter_mm + rise;
  }
  return slices < 3 ? 0 : round / static_cast<double>((slices - 2) * kSlice);
}

std::optional<FrameError> refusal(const Eigen::Matrix3Xd& points) {
  if (!points.allFinite()) {
    for (Eigen::Index n = 0; n < points.cols(); ++n) {
      if (!points.col(n).allFinite())
        return FrameError{"point " + std::to_string(n) + " has NaN or infinite coordinates; leave such points out"};
    }
  }
  if (points.cols() < kFewest) {
    return FrameError{std::to_string(points.cols()) + " points determine no axis; " + std::to_string(kFewest) +
                      " at least are needed"};
  }
  const Eigen::Vector3d mean = points.rowwise().mean();
  const Eigen::Matrix3Xd y = points.colwise() - mean;
  const Eigen::Vector3d widths = (y * y.transpose() / static_cast<double>(points.cols()))
                                     .selfadjointView<Eigen::Lower>()
                                     .eigenvalues()
                                     .cwiseMax(0)
                                     .cwiseSqrt();
  // Rounding of the coordinates themselves, far from the origin.
  const double rounding = 1e-7 * widths[2] + 1e-14 * mean.norm();
  if (!(widths[2] > 1e-14 * (1 + mean.norm())))
    return FrameError{"all points coincide; there is no shape to find an axis of"};
  if (widths[1] <= rounding) return FrameError{"all points lie on one line; an axis needs a surface around it"};
  if (widths[0] <= rounding) {
    return FrameError{"all points lie in one plane; every normal of a plane is an axis: give the axis yourself"};
  }
  return std::nullopt;
}

}  // namespace

const char* to_string(FrameShape shape) {
  static constexpr const char* names[] = {"sphere", "cylinder", "cone", "surface of revolution", "elliptic shape"};
  return names[static_cast<std::size_t>(shape)];
}

const char* to_string(AxisStart start) {
  static constexpr const char* names[] = {"quadric", "line geometry", "normals", "none"};
  return names[static_cast<std::size_t>(start)];
}

tl::expected<LocalFrame, FrameError> local_frame(const Eigen::Matrix3Xd& points) {
  if (auto refused = refusal(points)) return tl::make_unexpected(std::move(*refused));
  const SurfaceSample sample = sample_surface(points);
  Data data{sample.points, sample.weights};
  const Eigen::Vector3d centroid = data.points * data.weights / data.weights.sum();
  const double size =
      std::sqrt((data.points.colwise() - centroid).colwise().squaredNorm().dot(data.weights) / data.weights.sum());
  data.least_scale = 1e-12 * size + 1e-16 * centroid.norm();
  data.told_apart_mm = kRounding * size;

  // The quadric, reweighted by its own first-order distances.
  Eigen::VectorXd weights = data.weights;
  std::optional<QuadricFit> quadric;
  for (int round = 0; round < 6; ++round) {
    quadric = fit_quadric(data.points, {weights.data(), static_cast<std::size_t>(weights.size())});
    if (!quadric) break;
    Eigen::VectorXd distances(data.points.cols());
    for (Eigen::Index n = 0; n < distances.size(); ++n) {
      const Eigen::Vector3d x = data.points.col(n);
      distances[n] = quadric->quadric.value(x) / std::max(0.1, quadric->quadric.gradient(x).norm());
    }
    const double scale = std::max(data.least_scale, median_scale(distances, data.weights));
    for (Eigen::Index n = 0; n < distances.size(); ++n)
      weights[n] = data.weights[n] * tukey_weight(distances[n], scale);
  }
  std::optional<QuadricAxes> axes;
  if (quadric) {
    if (quadric->next_residual_mm <= 1e-7 * size) {
      return tl::make_unexpected(FrameError{
          "the points lie on one curve: several quadrics pass through all of them; an axis needs points of a surface"});
    }
    axes = quadric_axes(*quadric);
  }

  const auto [best, from] = race(starts_of(sample, quadric, axes, size), thinned(data, kRacers));
  const std::vector<Fitted> fits = candidates(best, data);
  const std::vector<double> costs = costs_of(fits, data);
  const double lowest = *std::min_element(costs.begin(), costs.end());
  if (!std::isfinite(lowest)) {
    return tl::make_unexpected(FrameError{"no round shape could be fitted to the points; give the axis yourself"});
  }
  const double allowed = kAsGood * lowest + (kAsGood - 1) * std::pow(data.told_apart_mm, 2);
  std::size_t chosen = 0;
  while (costs[chosen] > allowed) ++chosen;
  // Candidates stand from simple to general, but for a quartic before a quadratic with ellipses: fewer unknowns first.
  for (std::size_t n = chosen; n < fits.size(); ++n)
    if (costs[n] <= allowed && fits[n].unknowns() < fits[chosen].unknowns()) chosen = n;
  const Fitted& fit = fits[chosen];

  LocalFrame frame;
  frame.shape = fit.kind;
  frame.quadric = axes ? axes->type : QuadricType::none;
  frame.scale_mm = fit.solution.scale;
  frame.noise_mm = sample.noise_mm;
  frame.inliers = fit.solution.inliers * sample.weights.sum() / static_cast<double>(sample.weights.size());
  const std::string left = "scatter " + number(fit.solution.scale) + " mm";
  if (const auto* sphere = std::get_if<Sphere>(&fit.shape)) {
    frame.X_SL.translation() = sphere->centre_mm;
    frame.axis_sd_rad = std::numeric_limits<double>::infinity();
    frame.origin_sd_mm =
        fit.solution.covariance.size() > 0
            ? std::sqrt(fit.solution.covariance.topLeftCorner<3, 3>().selfadjointView<Eigen::Lower>().eigenvalues()[2])
            : frame.axis_sd_rad;
    frame.reason = "a sphere of radius " + number(sphere->radius_mm, "%.4g") + " mm fits as well as anything (" + left +
                   "): its centre is the origin, the axis stays as it is";
  } else {
    const AxisFrame axis = std::holds_alternative<Cone>(fit.shape) ? std::get<Cone>(fit.shape).axis
                                                                   : std::get<MeridianSurface>(fit.shape).axis;
    frame.start = from;
    const double known = sample.weights.sum() / static_cast<double>(sample.weights.size());
    frame.inliers =
        std::max(frame.inliers, known * share_round(data, axis, std::min(fit.solution.scale, 3 * sample.noise_mm)));
    place_on_axis(fit, axis, quadric, axes, data, frame);
    frame.reason = std::string("axis of the ") + to_string(fit.kind) + " that fits best (" + left +
                   "), found from the " + to_string(from);
    if (from == AxisStart::quadric && axes)
      frame.reason += std::string(" (") + to_string(axes->type) + ": " + to_string(axes->reason) + ")";
    if (!(frame.axis_sd_rad < 1.0 / degrees(1))) {
      frame.warnings.push_back("the points determine the axis only to " +
                               (std::isfinite(frame.axis_sd_rad) ? number(degrees(frame.axis_sd_rad)) + " degrees"
                                                                 : std::string("no accuracy at all")) +
                               "; measure more of the circumference or give the axis yourself");
    }
  }
  if (frame.origin_sd_mm > 0.05 * size) {
    frame.warnings.push_back("the points determine the origin only to " + number(frame.origin_sd_mm) +
                             " mm; measure more of the shape");
  }
  if (frame.inliers < 0.8) {
    frame.warnings.push_back(number(100 * (1 - frame.inliers)) + " % of the points do not lie on the shape found");
  }
  return frame;
}

}  // namespace celadon
