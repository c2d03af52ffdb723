#include "daemon/dimensions.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <optional>
#include <tuple>

#include "daemon/shape_least_squares.h"
#include "fitting/robust_least_squares.h"
#include "fitting/round_shapes.h"

namespace celadon {
namespace {

constexpr double kRounding_mm = 1e-9;
constexpr const char* kUndetermined =
    "the points do not determine the shape: they show too small a part of it; scan more of its turn and height";
constexpr const char* kConeAngle = "cone angle";

/// Number of the profile of each point.
std::vector<int> profiles_of(const ScannedPoints& points) {
  std::map<std::tuple<int, double, double, double>, int> numbers;
  std::vector<int> out;
  for (std::size_t i = 0; i < points.laser.size(); ++i) {
    const AxisStop stop = points.stop.empty() ? AxisStop() : points.stop[i];
    const auto entry =
        numbers.try_emplace({points.laser[i], points.table_angle_rad[i], stop.elevation_rad, stop.lift_mm},
                            static_cast<int>(numbers.size()));
    out.push_back(entry.first->second);
  }
  return out;
}

/// Covariance of the unknowns from the residuals, profiles as the units that are independent (Liang and Zeger 1986).
Eigen::MatrixXd scatter_covariance(const Eigen::MatrixXd& J, const Eigen::VectorXd& weights,
                                   const Eigen::VectorXd& residuals, const std::vector<int>& profile, int profiles) {
  Eigen::MatrixXd scores = Eigen::MatrixXd::Zero(J.cols(), profiles);
  for (Eigen::Index i = 0; i < J.rows(); ++i) {
    scores.col(profile[static_cast<std::size_t>(i)]) += weights[i] * residuals[i] * J.row(i).transpose();
  }
  const Eigen::MatrixXd inverse = (J.transpose() * weights.asDiagonal() * J).inverse();
  const double few = static_cast<double>(profiles) / static_cast<double>(profiles - J.cols());
  return few * inverse * scores * scores.transpose() * inverse;
}

template <class Shape, class ValuesOf>
tl::expected<Dimensions, std::string> measure(Shape shape, const std::vector<std::string>& names,
                                              const ValuesOf& values_of, const ScannedPoints& points,
                                              const Calibration& calibration) {
  const Eigen::Matrix3Xd& p = points.p_mm;
  const Eigen::VectorXd ones = Eigen::VectorXd::Ones(p.cols());
  const RobustSolution found = fit_robustly(shape, p, ones, kRounding_mm);
  if (!found.converged || found.covariance.size() == 0) {
    return tl::unexpected(std::string(kUndetermined));
  }
  Eigen::VectorXd residuals(p.cols()), weights(p.cols());
  shape.residuals(p, residuals, nullptr);
  for (Eigen::Index i = 0; i < p.cols(); ++i) {
    weights[i] = tukey_weight(residuals[i], std::max(found.scale, kRounding_mm)) > 0 ? 1 : 0;
  }
  if (!least_squares(shape, p, weights, residuals)) return tl::unexpected(std::string(kUndetermined));
  Eigen::MatrixXd J(p.cols(), shape.unknowns());
  shape.residuals(p, residuals, &J);

  const std::vector<int> profile = profiles_of(points);
  const int profiles = 1 + *std::max_element(profile.begin(), profile.end());
  const Eigen::VectorXd values = values_of(shape);
  Eigen::MatrixXd by(values.size(), shape.unknowns());
  for (Eigen::Index j = 0; j < by.cols(); ++j) {
    constexpr double kStep = 1e-6;
    Eigen::VectorXd step = Eigen::VectorXd::Zero(by.cols());
    step[j] = kStep;
    by.col(j) = (values_of(shape.moved(step)) - values_of(shape.moved(-step))) / (2 * kStep);
  }
  const Eigen::MatrixXd scatter = by * scatter_covariance(J, weights, residuals, profile, profiles) * by.transpose();
  const Eigen::MatrixXd of_calibration = calibration_covariance_of(
      [&](const Eigen::Matrix3Xd& moved) {
        Shape follows = shape;
        Eigen::VectorXd left;
        least_squares(follows, moved, weights, left);
        return values_of(follows);
      },
      points, calibration);

  Dimensions out;
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    const double a = std::max(0.0, scatter(i, i)), b = std::max(0.0, of_calibration(i, i));
    const std::string& name = names[static_cast<std::size_t>(i)];
    out.values.push_back(
        {name, name == kConeAngle ? "rad" : "mm", values[i], std::sqrt(a + b), std::sqrt(a), std::sqrt(b)});
  }
  const double kept = weights.sum();
  out.form_mm = std::sqrt(weights.dot(residuals.cwiseAbs2()) / std::max(1.0, kept - static_cast<double>(J.cols())));
  out.left_out = 1 - kept / static_cast<double>(p.cols());
  return out;
}

}  // namespace

tl::expected<Dimensions, std::string> dimensions_of(RoundShape shape, const ScannedPoints& points,
                                                    const Calibration& calibration, double at_z_mm) {
  constexpr Eigen::Index kFewestPoints = 30;
  constexpr int kFewestProfiles = 12;
  const Eigen::Matrix3Xd& p = points.p_mm;
  if (p.cols() < kFewestPoints) {
    return tl::unexpected("the shape has " + std::to_string(p.cols()) +
                          " points and needs 30 to be measured; scan more of it");
  }
  const std::vector<int> profile = profiles_of(points);
  if (const int profiles = 1 + *std::max_element(profile.begin(), profile.end()); profiles < kFewestProfiles) {
    return tl::unexpected("the shape was seen in " + std::to_string(profiles) +
                          " profiles and needs 12 to tell how sure its size is; scan with more profiles");
  }
  const Eigen::VectorXd ones = Eigen::VectorXd::Ones(p.cols());
  if (shape == RoundShape::sphere) {
    return measure(
        sphere_through(p, ones), {"diameter"},
        [](const Sphere& s) { return Eigen::VectorXd::Constant(1, 2 * s.radius_mm).eval(); }, points, calibration);
  }
  Cone start = cylinder_through(p, ones, Eigen::Vector3d::UnitZ());
  start.cylinder = shape == RoundShape::cylinder;
  if (start.cylinder) {
    return measure(
        start, {"diameter"}, [](const Cone& c) { return Eigen::VectorXd::Constant(1, 2 * c.radius_mm).eval(); }, points,
        calibration);
  }
  char name[64];
  std::snprintf(name, sizeof name, "diameter at z = %.6g mm", at_z_mm);
  return measure(
      start, {name, kConeAngle},
      [at_z_mm](const Cone& c) {
        const double h = (at_z_mm - c.axis.point_mm.z()) / c.axis.axes(2, 2);
        return Eigen::VectorXd(Eigen::Vector2d(2 * (c.radius_mm + c.slope * h), 2 * std::atan(c.slope)));
      },
      points, calibration);
}

}  // namespace celadon
