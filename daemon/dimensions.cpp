#include "daemon/dimensions.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "daemon/shape_measurement.h"
#include "fitting/round_shapes.h"

namespace celadon {
namespace {

constexpr const char* kConeAngle = "cone angle";

template <class Shape, class ValuesOf>
tl::expected<Dimensions, std::string> measure(Shape shape, const std::vector<std::string>& names,
                                              const ValuesOf& values_of, const ScannedPoints& points,
                                              const Calibration& calibration) {
  const auto measured = measure_shape(std::move(shape), points);
  if (!measured) return tl::unexpected(measured.error());
  const Eigen::VectorXd values = values_of(measured->shape);
  const Eigen::MatrixXd by = measured->slopes(values_of);
  const Eigen::MatrixXd scatter = by * measured->scatter * by.transpose();
  const Eigen::MatrixXd of_calibration = calibration_covariance_of(
      [&](const Eigen::Matrix3Xd& moved) {
        Shape follows = measured->shape;
        Eigen::VectorXd left;
        least_squares(follows, moved, measured->weights, left);
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
  const double kept = measured->weights.sum();
  out.form_mm = std::sqrt(measured->weights.dot(measured->residuals_mm.cwiseAbs2()) /
                          std::max(1.0, kept - static_cast<double>(by.cols())));
  out.left_out = 1 - kept / static_cast<double>(points.p_mm.cols());
  return out;
}

}  // namespace

tl::expected<Dimensions, std::string> dimensions_of(RoundShape shape, const ScannedPoints& points,
                                                    const Calibration& calibration, double at_z_mm) {
  if (const auto few = too_few(points)) return tl::unexpected(*few);
  const Eigen::Matrix3Xd& p = points.p_mm;
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
