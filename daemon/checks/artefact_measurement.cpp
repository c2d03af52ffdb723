#include "daemon/checks/artefact_measurement.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>
#include <numeric>
#include <utility>

#include "daemon/shape_measurement.h"
#include "fitting/round_shapes.h"

namespace celadon {
namespace {

using Eigen::Vector3d;
using Indices = std::vector<std::size_t>;

constexpr std::size_t kPlacementPoints = 3000, kFitPoints = 2000;
constexpr double kSearch_mm = 4;  // about where a ball should be: the placement is good to a few millimetres
constexpr double kOff_mm = 6;     // a ball found further from its place, or so much larger or smaller, is another thing

/// Distance to a plane. Unknowns: turns about i and j of its frame, whose k is the normal, and a shift along k.
struct Plane {
  AxisFrame frame;

  static int unknowns() { return 3; }
  Plane moved(const Eigen::VectorXd& step) const {
    Plane next{frame.moved({step[0], step[1], 0, 0})};
    next.frame.point_mm += step[2] * frame.axes.col(2);
    return next;
  }
  void residuals(const Eigen::Matrix3Xd& points, Eigen::VectorXd& values, Eigen::MatrixXd* jacobian) const {
    for (Eigen::Index n = 0; n < points.cols(); ++n) {
      const Vector3d y = frame.local(points.col(n));
      values[n] = y.z();
      if (jacobian) jacobian->row(n) << -y.y(), y.x(), -1;
    }
  }
};

ScannedPoints chosen(const ScannedPoints& points, const Indices& indices) {
  ScannedPoints out;
  out.p_mm.resize(3, static_cast<Eigen::Index>(indices.size()));
  for (std::size_t k = 0; k < indices.size(); ++k) {
    const std::size_t i = indices[k];
    out.p_mm.col(static_cast<Eigen::Index>(k)) = points.p_mm.col(static_cast<Eigen::Index>(i));
    out.table_angle_rad.push_back(points.table_angle_rad[i]);
    out.laser.push_back(points.laser[i]);
    if (!points.stop.empty()) out.stop.push_back(points.stop[i]);
  }
  return out;
}

/// At most about so many, evenly; not at a divisor of what repeats from profile to profile.
Indices thinned(const Indices& indices, std::size_t most) {
  const std::size_t every = std::max<std::size_t>(1, indices.size() / most) | 1;
  Indices out;
  for (std::size_t k = every / 2; k < indices.size(); k += every) out.push_back(indices[k]);
  return out;
}

Indices near_sphere(const ScannedPoints& points, const Sphere& sphere, double reach_mm) {
  const double lowest = -std::cos(kHeld_rad);
  Indices out;
  for (Eigen::Index i = 0; i < points.p_mm.cols(); ++i) {
    const Vector3d x = points.p_mm.col(i) - sphere.centre_mm;
    const double r = x.norm();
    if (std::abs(r - sphere.radius_mm) < reach_mm && x.z() > lowest * r) out.push_back(static_cast<std::size_t>(i));
  }
  return out;
}

double width_of(const std::vector<double>& sorted, double share) {
  const auto held = static_cast<std::size_t>(std::ceil(share * static_cast<double>(sorted.size())));
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i + held <= sorted.size(); ++i) least = std::min(least, sorted[i + held - 1] - sorted[i]);
  return least;
}

/// The widths, and by the jackknife what they scatter by: without each eighth of the profiles in turn.
/// @pre eight profiles or more
MeasuredForm form_of(const Eigen::VectorXd& residuals, const std::vector<int>& profile) {
  constexpr int kParts = 8;
  constexpr double kMost = 0.95;
  std::vector<std::pair<double, int>> sorted;
  for (std::size_t i = 0; i < profile.size(); ++i) {
    sorted.emplace_back(residuals[static_cast<Eigen::Index>(i)], profile[i] % kParts);
  }
  std::sort(sorted.begin(), sorted.end());
  const auto widths_without = [&](int part) -> Eigen::Array2d {
    std::vector<double> values;
    for (const auto& [value, of] : sorted) {
      if (of != part) values.push_back(value);
    }
    return {width_of(values, 1), width_of(values, kMost)};
  };
  Eigen::Array2Xd left(2, kParts);
  for (int part = 0; part < kParts; ++part) left.col(part) = widths_without(part);
  const Eigen::Array2d u =
      ((left.colwise() - left.rowwise().mean().eval()).square().rowwise().sum() * ((kParts - 1.) / kParts)).sqrt();
  const Eigen::Array2d all = widths_without(-1);
  return {all[0], u[0], all[1], u[1], profile.size()};
}

/// Share of fields of equal area, twelve of height by 24 around, that hold a point.
double seen_of(const Sphere& sphere, const ScannedPoints& points, const Indices& indices) {
  constexpr int kHigh = 12, kAround = 24;
  std::vector<char> seen(kHigh * kAround, 0);
  for (const std::size_t i : indices) {
    const Vector3d x = (points.p_mm.col(static_cast<Eigen::Index>(i)) - sphere.centre_mm).normalized();
    const double around = std::atan2(x.y(), x.x()) / (2 * std::numbers::pi) + 0.5;
    const int row = std::clamp(static_cast<int>((x.z() + 1) / 2 * kHigh), 0, kHigh - 1);
    const int column = std::clamp(static_cast<int>(around * kAround), 0, kAround - 1);
    seen[static_cast<std::size_t>(row * kAround + column)] = 1;
  }
  return static_cast<double>(std::accumulate(seen.begin(), seen.end(), 0)) / (kHigh * kAround);
}

std::string too_little(double seen, double least, const char* what) {
  char text[240];
  std::snprintf(
      text, sizeof text,
      "%.0f %% of %s is seen and %.0f %% is needed; turn the artefact so that nothing hides it, scan with more "
      "profiles, or clean it",
      100 * seen, what, 100 * least);
  return text;
}

/// A ball, found in the points.
struct FoundBall {
  ScannedPoints points;  ///< some of them, evenly
  MeasuredShape<Sphere> fit;
};

std::optional<FoundBall> find_ball(const CertifiedSphere& certified, const ArtefactPlacement& placement,
                                   const ScannedPoints& points, MeasuredSphere& out) {
  const Sphere expected{placement.point(certified.centre_mm), certified.diameter.value / 2};
  Sphere sphere = expected;
  std::optional<FoundBall> found;
  for (const double reach_mm : {kSearch_mm, kOfSurface_mm, kOfSurface_mm}) {
    FoundBall ball{chosen(points, thinned(near_sphere(points, sphere, reach_mm), kFitPoints)), {}};
    if (const auto few = too_few(ball.points)) {
      out.missing = "where the ball should be, " + *few;
      return std::nullopt;
    }
    auto fit = measure_shape(sphere, ball.points);
    if (!fit) {
      out.missing = "where the ball should be, " + fit.error();
      return std::nullopt;
    }
    if (!((fit->shape.centre_mm - expected.centre_mm).norm() < kOff_mm &&
          std::abs(fit->shape.radius_mm - expected.radius_mm) < kOff_mm)) {
      out.missing = "no ball is found where it should be; compare the artefact with its file";
      return std::nullopt;
    }
    sphere = fit->shape;
    ball.fit = std::move(*fit);
    found = std::move(ball);
  }
  const Indices all = near_sphere(points, sphere, kOfSurface_mm);
  out.seen = seen_of(sphere, points, all);
  if (out.seen < kLeastOfSphere) {
    out.missing = too_little(out.seen, kLeastOfSphere, "the ball's surface");
    return std::nullopt;
  }
  const ScannedPoints on_ball = chosen(points, all);
  Eigen::VectorXd residuals(on_ball.p_mm.cols());
  sphere.residuals(on_ball.p_mm, residuals, nullptr);
  out.form = form_of(residuals, profiles_of(on_ball));
  out.centre_mm = sphere.centre_mm;
  return found;
}

/// Diameters of the balls that were found, then the spacings between them; with both parts of their uncertainty.
void measure_lengths(const Artefact& artefact, const std::vector<std::optional<FoundBall>>& balls,
                     const Calibration& calibration, ArtefactMeasurement& out) {
  std::vector<std::size_t> found;
  std::vector<Eigen::Index> place(balls.size(), -1);  // of each ball in `found`
  std::vector<MeasuredLength*> lengths;
  for (std::size_t i = 0; i < balls.size(); ++i) {
    if (!balls[i]) continue;
    place[i] = static_cast<Eigen::Index>(found.size());
    found.push_back(i);
    lengths.push_back(&out.spheres[i].diameter);
  }
  std::vector<std::pair<Eigen::Index, Eigen::Index>> between;
  for (std::size_t k = 0; k < artefact.spacings.size(); ++k) {
    const CertifiedSpacing& spacing = artefact.spacings[k];
    if (!balls[spacing.first] || !balls[spacing.second]) {
      out.spacings[k].missing =
          "ball " + artefact.spheres[balls[spacing.first] ? spacing.second : spacing.first].name + " is not measured";
      continue;
    }
    between.emplace_back(place[spacing.first], place[spacing.second]);
    lengths.push_back(&out.spacings[k].distance);
  }
  if (found.empty()) return;

  ScannedPoints joined;
  std::vector<Eigen::Index> begin{0};
  for (const std::size_t i : found) {
    const ScannedPoints& points = balls[i]->points;
    begin.push_back(begin.back() + points.p_mm.cols());
    joined.p_mm.conservativeResize(3, begin.back());
    joined.p_mm.rightCols(points.p_mm.cols()) = points.p_mm;
    joined.table_angle_rad.insert(joined.table_angle_rad.end(), points.table_angle_rad.begin(),
                                  points.table_angle_rad.end());
    joined.laser.insert(joined.laser.end(), points.laser.begin(), points.laser.end());
    joined.stop.insert(joined.stop.end(), points.stop.begin(), points.stop.end());
  }
  const auto lengths_of = [&](const std::vector<Sphere>& spheres) {
    Eigen::VectorXd values(static_cast<Eigen::Index>(lengths.size()));
    Eigen::Index n = 0;
    for (const Sphere& sphere : spheres) values[n++] = 2 * sphere.radius_mm;
    for (const auto& [a, b] : between) {
      values[n++] =
          (spheres[static_cast<std::size_t>(a)].centre_mm - spheres[static_cast<std::size_t>(b)].centre_mm).norm();
    }
    return values;
  };
  std::vector<Sphere> spheres;
  for (const std::size_t i : found) spheres.push_back(balls[i]->fit.shape);
  const Eigen::VectorXd values = lengths_of(spheres);
  const Eigen::MatrixXd of_calibration = calibration_covariance_of(
      [&](const Eigen::Matrix3Xd& moved) {
        std::vector<Sphere> follow = spheres;
        for (std::size_t k = 0; k < found.size(); ++k) {
          Eigen::VectorXd left;
          least_squares(follow[k], moved.middleCols(begin[k], begin[k + 1] - begin[k]), balls[found[k]]->fit.weights,
                        left);
        }
        return lengths_of(follow);
      },
      joined, calibration);
  const auto scatter_of = [&](Eigen::Index ball) -> const Eigen::MatrixXd& {
    return balls[found[static_cast<std::size_t>(ball)]]->fit.scatter;
  };
  for (Eigen::Index n = 0; n < values.size(); ++n) {
    const auto balls_found = static_cast<Eigen::Index>(found.size());
    double variance = 0;
    if (n < balls_found) {
      variance = 4 * scatter_of(n)(3, 3);
    } else {
      const auto& [a, b] = between[static_cast<std::size_t>(n - balls_found)];
      const Vector3d along =
          (spheres[static_cast<std::size_t>(a)].centre_mm - spheres[static_cast<std::size_t>(b)].centre_mm)
              .normalized();
      variance = along.dot((scatter_of(a) + scatter_of(b)).topLeftCorner<3, 3>() * along);
    }
    *lengths[static_cast<std::size_t>(n)] = {values[n], std::sqrt(std::max(0.0, variance)),
                                             std::sqrt(std::max(0.0, of_calibration(n, n)))};
  }
}

MeasuredFlat measure_flat(const CertifiedFlat& certified, const ArtefactPlacement& placement,
                          const ScannedPoints& points) {
  MeasuredFlat out;
  Plane plane;
  const Vector3d normal = placement.direction(certified.normal);
  Vector3d across = Vector3d::UnitZ().cross(normal);
  across = across.norm() > 1e-6 ? across.normalized() : placement.direction(Vector3d::UnitX());
  plane.frame.axes << across, normal.cross(across), normal;
  plane.frame.point_mm = placement.point(certified.centre_mm);
  const AxisFrame rectangle = plane.frame;
  const Eigen::Array2d half(certified.width_mm / 2 - kBorder_mm, certified.height_mm / 2 - kBorder_mm);
  const auto near_plane = [&](double reach_mm) {
    Indices near;
    for (Eigen::Index i = 0; i < points.p_mm.cols(); ++i) {
      const Eigen::Array2d at = rectangle.local(points.p_mm.col(i)).head<2>().array();
      if ((at.abs() < half).all() && std::abs(plane.frame.local(points.p_mm.col(i)).z()) < reach_mm) {
        near.push_back(static_cast<std::size_t>(i));
      }
    }
    return near;
  };
  for (const double reach_mm : {kSearch_mm, kOfSurface_mm}) {
    const ScannedPoints some = chosen(points, thinned(near_plane(reach_mm), kFitPoints));
    if (const auto few = too_few(some)) {
      out.missing = "where the flat should be, " + *few;
      return out;
    }
    const auto fit = measure_shape(plane, some);
    if (!fit) {
      out.missing = "where the flat should be, " + fit.error();
      return out;
    }
    plane = fit->shape;
  }
  const ScannedPoints on_flat = chosen(points, near_plane(kOfSurface_mm));
  constexpr int kFields = 10;  // along each side
  std::vector<char> seen(kFields * kFields, 0);
  for (Eigen::Index i = 0; i < on_flat.p_mm.cols(); ++i) {
    const Eigen::Array2d at = (rectangle.local(on_flat.p_mm.col(i)).head<2>().array() / half + 1) / 2 * kFields;
    seen[static_cast<std::size_t>(static_cast<int>(at[0]) * kFields + static_cast<int>(at[1]))] = 1;
  }
  out.seen = static_cast<double>(std::accumulate(seen.begin(), seen.end(), 0)) / (kFields * kFields);
  if (out.seen < kLeastOfFlat) {
    out.missing = too_little(out.seen, kLeastOfFlat, "the flat");
    return out;
  }
  Eigen::VectorXd residuals(on_flat.p_mm.cols());
  plane.residuals(on_flat.p_mm, residuals, nullptr);
  out.form = form_of(residuals, profiles_of(on_flat));
  return out;
}

}  // namespace

tl::expected<ArtefactMeasurement, std::string> measure_artefact(const Artefact& artefact, const ScannedPoints& points,
                                                                const Calibration& calibration) {
  Indices all(points.laser.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  const auto placement = find_placement(artefact, chosen(points, thinned(all, kPlacementPoints)).p_mm);
  if (!placement) return tl::unexpected(placement.error());
  ArtefactMeasurement out;
  out.placement = *placement;
  out.spheres.resize(artefact.spheres.size());
  out.spacings.resize(artefact.spacings.size());
  std::vector<std::optional<FoundBall>> balls;
  std::vector<std::optional<Vector3d>> centres;
  for (std::size_t i = 0; i < artefact.spheres.size(); ++i) {
    balls.push_back(find_ball(artefact.spheres[i], *placement, points, out.spheres[i]));
    centres.push_back(balls.back() ? std::optional(out.spheres[i].centre_mm) : std::nullopt);
  }
  measure_lengths(artefact, balls, calibration, out);
  const auto found = std::count_if(centres.begin(), centres.end(), [](const auto& c) { return c.has_value(); });
  if (found >= 2) out.placement = placement_through(artefact, centres);
  if (artefact.flat) {
    out.flat = found >= 2 ? measure_flat(*artefact.flat, out.placement, points)
                          : MeasuredFlat{"too few balls are found to tell where the flat is", 0, {}};
  }
  return out;
}

}  // namespace celadon
