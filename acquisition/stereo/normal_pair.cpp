#include "acquisition/stereo/normal_pair.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>

namespace celadon {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kLeastTurn_rad = 0.005, kMostTurn_rad = 0.5;
constexpr double kLeastAcross = 0.1;  // of the view's direction across the table's axis

Matrix3d turn_about_z(double angle_rad) {
  return Eigen::AngleAxisd(angle_rad, Vector3d::UnitZ()).toRotationMatrix();
}

std::string turn_refused(double turned_rad) {
  char text[240];
  std::snprintf(text, sizeof text,
                "The table turned by %.3f degrees between the two pictures of a pair; turn it by %.1f to %.0f degrees, "
                "best by %.0f.",
                turned_rad * 180 / std::numbers::pi, kLeastTurn_rad * 180 / std::numbers::pi,
                kMostTurn_rad * 180 / std::numbers::pi, kPairTurn_rad * 180 / std::numbers::pi);
  return text;
}

}  // namespace

tl::expected<NormalPair, std::string> NormalPair::make(const Calibration& calibration, double first_rad,
                                                       double second_rad) {
  NormalPair pair(calibration);
  const double first_table_rad = calibration.encoder.table_rad(first_rad),
               second_table_rad = calibration.encoder.table_rad(second_rad);
  pair.turned_rad_ = second_table_rad - first_table_rad;
  if (!(std::abs(pair.turned_rad_) >= kLeastTurn_rad && std::abs(pair.turned_rad_) <= kMostTurn_rad))
    return tl::make_unexpected(turn_refused(pair.turned_rad_));
  pair.middle_rad_ = 0.5 * (first_table_rad + second_table_rad);
  const CameraModel& camera = calibration.camera_model;
  pair.width_px_ = camera.width_px;
  pair.height_px_ = camera.height_px;
  pair.scale_ = calibration.scale.value;
  pair.f_px_ = 0.5 * (camera.fx_px.value + camera.fy_px.value);

  // The object stands and the camera goes round it: p_C = X_CW R_z(-+ turned / 2) p_M.
  const Eigen::Isometry3d& X_CW = calibration.axis.X_CW;
  const Vector3d centre_S = X_CW.inverse().translation();
  std::array<Matrix3d, 2> R_CM;
  for (std::size_t k = 0; k < 2; ++k) {
    const double half = (k == 0 ? -0.5 : 0.5) * pair.turned_rad_;
    R_CM[k] = X_CW.linear() * turn_about_z(half);
    pair.centre_M_[k] = turn_about_z(-half) * centre_S;
  }
  const Matrix3d mean = 0.5 * (R_CM[0] + R_CM[1]);
  const Vector3d between = pair.centre_M_[1] - pair.centre_M_[0];
  const Vector3d along = between.normalized();
  const Vector3d in_view = mean * along;
  const double side = std::abs(in_view.x()) >= std::abs(in_view.y()) ? in_view.x() : in_view.y();
  const Vector3d x = side < 0 ? Vector3d(-along) : along;
  Vector3d z = mean.transpose().col(2);
  z = (z - x * x.dot(z)).normalized();
  // The axis's point that is nearest to the middle of the view.
  const Vector3d middle_M = 0.5 * (pair.centre_M_[0] + pair.centre_M_[1]);
  const double across = z.head<2>().squaredNorm();
  if (!(between.norm() > 0 && across > kLeastAcross * kLeastAcross))
    return tl::make_unexpected(
        std::string("The camera looks along the table's axis: turning the table shows nothing from another side. Raise "
                    "the camera less, or scan with a laser."));
  const double to_axis = -middle_M.head<2>().dot(z.head<2>()) / across;
  if (!(to_axis > 0)) {
    return tl::make_unexpected(
        std::string("The table's axis lies behind the camera, by the calibration; calibrate the machine again."));
  }
  const Vector3d on_axis(0, 0, middle_M.z() + to_axis * z.z());
  const Vector3d y = z.cross(x);
  pair.R_MN_.col(0) = x;
  pair.R_MN_.col(1) = y;
  pair.R_MN_.col(2) = z;
  for (std::size_t k = 0; k < 2; ++k) {
    pair.R_CN_[k] = R_CM[k] * pair.R_MN_;
    const Vector3d p = on_axis - pair.centre_M_[k];
    pair.cx_px_[k] = 0.5 * (pair.width_px_ - 1) - pair.f_px_ * x.dot(p) / z.dot(p);
    pair.cy_px_ = 0.5 * (pair.height_px_ - 1) - pair.f_px_ * y.dot(p) / z.dot(p);
    pair.axis_mm_ = z.dot(p);
  }
  pair.baseline_mm_ = x.dot(between);
  return pair;
}

Eigen::Vector2d NormalPair::pixel(std::size_t picture, double x_px, double y_px) const {
  const Vector3d n((x_px - cx_px_[picture]) / f_px_, (y_px - cy_px_) / f_px_, 1);
  const Vector3d v = R_CN_[picture] * n;
  if (!(v.z() > 0)) return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  return lens_.project(v.x() / v.z(), v.y() / v.z());
}

Eigen::Vector2d NormalPair::normal(std::size_t picture, const Eigen::Vector2d& pixel) const {
  const UndistortedPoint ray = lens_.undistort(pixel.x(), pixel.y());
  const Vector3d n = R_CN_[picture].transpose() * Vector3d(ray.a, ray.b, 1);
  return {cx_px_[picture] + f_px_ * n.x() / n.z(), cy_px_ + f_px_ * n.y() / n.z()};
}

StereoPoint NormalPair::point(double x_px, double y_px, double disparity_px) const {
  const double fb = f_px_ * baseline_mm_;
  const double apart_px = disparity_px + fb / axis_mm_;  // x_L - x_R of pictures that look along parallel axes
  const double depth = fb / apart_px;
  const Vector3d ray((x_px - cx_px_[0]) / f_px_, (y_px - cy_px_) / f_px_, 1);
  const Vector3d ray_M = R_MN_ * ray;
  const Vector3d p_M = centre_M_[0] + depth * ray_M;
  // Another angle of the second picture turns the point before its camera; the depth follows along the first ray, so
  // that the second picture shows it where it was. Both angles together turn the point.
  const Vector3d turning = Vector3d::UnitZ().cross(p_M);
  const double along = turning.dot(R_MN_.col(0)), away = turning.dot(R_MN_.col(2));
  const double right = (p_M - centre_M_[1]).dot(R_MN_.col(0));
  const double x2_by_rad = f_px_ * (along / depth - right * away / (depth * depth));
  const Vector3d by_second_M = ray_M * (-x2_by_rad * depth * depth / fb);
  const Matrix3d back = scale_ * turn_about_z(-middle_rad_);
  return {back * p_M, back * ray_M * (-depth / apart_px), back * (-turning - by_second_M), back * by_second_M};
}

DisparityRange NormalPair::range_to(double reach_mm) const {
  const double fb = f_px_ * baseline_mm_;
  // A camera that looks downwards sees what is low further away.
  const double upright = 0.5 * std::max(width_px_, height_px_) * axis_mm_ / f_px_ * std::abs(R_MN_(2, 2));
  const double reach = reach_mm / scale_ * R_MN_.col(2).head<2>().norm();
  // Never so near to the camera that a search would have no end.
  const double near = std::max(axis_mm_ - reach - upright, 0.4 * axis_mm_), far = axis_mm_ + 0.5 * reach + upright;
  const double a = fb / near - fb / axis_mm_, b = fb / far - fb / axis_mm_;
  return {static_cast<int>(std::floor(std::min(a, b))), static_cast<int>(std::ceil(std::max(a, b)))};
}

double NormalPair::view_reach_mm() const {
  return scale_ * 0.5 * std::max(width_px_, height_px_) * axis_mm_ / f_px_;
}

}  // namespace celadon
