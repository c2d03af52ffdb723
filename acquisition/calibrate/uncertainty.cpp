// Formulas: README.md, (8) to (10), (13).
#include "acquisition/calibrate/uncertainty.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "acquisition/calibrate/frame_change.h"
#include "acquisition/calibrate/line_distance.h"

namespace celadon::calibrate {
namespace {

using Eigen::RowVectorXd;
using Eigen::Vector3d;

double deviation(const RowVectorXd& by, const Eigen::MatrixXd& covariance) {
  return std::sqrt(std::max(0.0, (by * covariance * by.transpose()).value()));
}

double worst_direction(const Eigen::Matrix2d& covariance) {
  return std::sqrt(std::max(0.0, Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(covariance).eigenvalues()[1]));
}

}  // namespace

std::vector<VolumePoint> volume_of(const Observations& observations, const Estimate& estimate) {
  constexpr std::size_t kAboutForEachLaser = 400;
  std::vector<std::size_t> totals(estimate.planes.size());
  const auto each_point = [&](auto&& visit) {
    for (const ViewObservation& view : observations.views) {
      for (const LineObservation& line : view.lines) {
        if (!view.used || !line.used || line.plane < 0) continue;
        for (const PointObservation& point : line.points) {
          if (point.weight > 0) visit(static_cast<std::size_t>(line.plane), point);
        }
      }
    }
  };
  each_point([&](std::size_t plane, const PointObservation&) { ++totals[plane]; });
  std::vector<std::size_t> seen(estimate.planes.size());
  std::vector<VolumePoint> out;
  each_point([&](std::size_t plane, const PointObservation& point) {
    if (seen[plane]++ % (totals[plane] / kAboutForEachLaser + 1) != 0) return;
    const PlaneEstimate& of = estimate.planes[plane];
    const PlanePoint at = plane_point(ray_of(estimate.camera.data(), point.p_px), of.normal_C, of.distance_mm);
    if (at.exists) out.push_back({plane, point.p_px, at.p_C});
  });
  return out;
}

Uncertainty::Uncertainty(const Estimate& estimate, SharedInformation information, std::vector<VolumePoint> volume)
    : estimate_(estimate), layout_(estimate), information_(std::move(information)), volume_(std::move(volume)) {
  // One chance in two thousand that sound residuals are beyond.
  constexpr double kBeyondChance = 3.3;
  const double dof = std::max(1, information_.degrees_of_freedom), ratio = information_.chi_square / dof;
  if (ratio > 1 + kBeyondChance * std::sqrt(2 / dof)) inflation_ = std::sqrt(ratio);
  information_.covariance =
      with_shared_errors(inflation_ * inflation_ * information_.covariance, inflation_, information_.groupings);
  if (estimate.axis->turn < 0) {
    information_.covariance.middleRows<3>(layout_.turn) *= -1;
    information_.covariance.middleCols<3>(layout_.turn) *= -1;
  }
  const Eigen::MatrixXd by_estimated = in_scanner_frame(estimate, layout_);
  information_.covariance = by_estimated * information_.covariance * by_estimated.transpose();
  RowVectorXd common = RowVectorXd::Zero(layout_.size);
  common.segment<2>(layout_.print) = 0.5 * estimate.pitch.cwiseInverse().transpose();
  const Eigen::VectorXd with_scale = information_.covariance * common.transpose();
  known_scale_ = information_.covariance;
  const double variance = common * with_scale;
  if (variance > 0) known_scale_ -= with_scale * with_scale.transpose() / variance;
}

std::vector<std::string> Uncertainty::names() const {
  std::vector<std::string> out(static_cast<std::size_t>(layout_.size));
  const auto put = [&](int first, const std::vector<std::string>& names) {
    std::copy(names.begin(), names.end(), out.begin() + first);
  };
  put(layout_.camera, {"fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3"});
  put(layout_.print, {"pitch_x", "pitch_y", "board.sag_x_mm", "board.sag_xy_mm", "board.sag_y_mm"});
  put(layout_.axis, {"axis.tilt_x_rad", "axis.tilt_y_rad", "axis.x_mm", "axis.y_mm"});
  put(layout_.turn, {"encoder.scale", "encoder.cos_rad", "encoder.sin_rad"});
  for (std::size_t i = 0; i < layout_.planes.size(); ++i) {
    const std::string laser = "laser" + std::to_string(estimate_.planes[i].laser);
    put(layout_.planes[i], {laser + ".tilt_up_rad", laser + ".tilt_across_rad", laser + ".offset_mm"});
  }
  if (layout_.platter >= 0) put(layout_.platter, {"platter.height_mm", "platter.slope_x", "platter.slope_y"});
  if (layout_.elevation >= 0) {
    put(layout_.elevation, {"elevation.tilt_up_rad", "elevation.tilt_across_rad", "elevation.up_mm",
                            "elevation.across_mm", "elevation.scale"});
  }
  if (layout_.lift >= 0) put(layout_.lift, {"lift.tilt_x_rad", "lift.tilt_y_rad", "lift.scale"});
  return out;
}

double Uncertainty::scale() const {
  RowVectorXd common = RowVectorXd::Zero(layout_.size);
  common.segment<2>(layout_.print) = 0.5 * estimate_.pitch.cwiseInverse().transpose();
  return deviation(common, information_.covariance);
}

double Uncertainty::of(int parameter, Scale scale) const {
  return std::sqrt(std::max(0.0, covariance(scale)(parameter, parameter)));
}

double Uncertainty::worst_of_two(int first, Scale scale) const {
  return worst_direction(covariance(scale).block<2, 2>(first, first));
}

double Uncertainty::plane_distance(std::size_t plane) const {
  const PlaneEstimate& of = estimate_.planes[plane];
  RowVectorXd by = RowVectorXd::Zero(layout_.size);
  by.segment<3>(layout_.planes[plane]) << of.anchor_C.transpose() * of.tangents_C, 1;
  return deviation(by, information_.covariance);
}

double Uncertainty::radius(Scale scale) const {
  const AxisEstimate& axis = *estimate_.axis;
  double largest = 0;
  for (const VolumePoint& place : volume_) {
    const PlaneEstimate& plane = estimate_.planes[place.plane];
    const Ray ray = ray_of(estimate_.camera.data(), place.p_px);
    const PlanePoint at = plane_point(ray, plane.normal_C, plane.distance_mm);
    const Vector3d from = at.p_C - axis.point_C;
    const double height = axis.direction_C.dot(from);
    const Vector3d across = from - height * axis.direction_C;
    const double r = across.norm();
    if (!at.exists || r < 1e-6) continue;
    const Eigen::RowVector3d outward = across.transpose() / r;
    RowVectorXd by = RowVectorXd::Zero(layout_.size);
    by.segment<9>(layout_.camera) = outward * at.by_camera;
    by.segment<3>(layout_.planes[place.plane])
        << outward * (at.by_normal + at.by_distance * plane.anchor_C.transpose()) * plane.tangents_C,
        outward * at.by_distance;
    by.segment<4>(layout_.axis) << -height * outward * axis.across_C, -outward * axis.across_C;
    largest = std::max(largest, deviation(by, covariance(scale)));
  }
  return largest;
}

double Uncertainty::plane_place(std::size_t plane, Scale scale) const {
  const PlaneEstimate& of = estimate_.planes[plane];
  double largest = 0;
  for (const VolumePoint& place : volume_) {
    if (place.plane != plane) continue;
    RowVectorXd by = RowVectorXd::Zero(layout_.size);
    by.segment<3>(layout_.planes[plane]) << (place.p_C - of.anchor_C).transpose() * of.tangents_C, -1;
    largest = std::max(largest, deviation(by, covariance(scale)));
  }
  return largest;
}

double Uncertainty::axis_from_plane(std::size_t plane, Scale scale) const {
  const AxisEstimate& axis = *estimate_.axis;
  const PlaneEstimate& of = estimate_.planes[plane];
  double largest = 0;
  for (const VolumePoint& place : volume_) {
    const double height = axis.direction_C.dot(place.p_C - axis.point_C);
    const Vector3d on_axis = axis.point_C + height * axis.direction_C;
    RowVectorXd by = RowVectorXd::Zero(layout_.size);
    by.segment<4>(layout_.axis) << height * of.normal_C.transpose() * axis.across_C,
        of.normal_C.transpose() * axis.across_C;
    by.segment<3>(layout_.planes[plane]) << (on_axis - of.anchor_C).transpose() * of.tangents_C, -1;
    largest = std::max(largest, deviation(by, covariance(scale)));
  }
  return largest;
}

double Uncertainty::axis_place(Scale scale) const {
  return worst_of_two(layout_.axis + 2, scale);
}

}  // namespace celadon::calibrate
