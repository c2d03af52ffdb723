#include "acquisition/calibrate/estimate.h"

#include <cmath>

namespace celadon::calibrate {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

/// Upward across a direction, and direction x upward; any two where the direction is upward itself.
Tangents upward_and_across(const Vector3d& direction, const Vector3d& up) {
  const Vector3d upward = up - direction * direction.dot(up);
  if (upward.norm() < 1e-6) return tangents_across(direction);
  Tangents out;
  out.col(0) = upward.normalized();
  out.col(1) = direction.cross(out.col(0));
  return out;
}

}  // namespace

MovedDirection moved_direction(const Vector3d& d0, const Tangents& tangents, const double* t) {
  const Vector3d raw = d0 + tangents * Vector2d(t[0], t[1]);
  const double length = raw.norm();
  const Vector3d d = raw / length;
  return {d, (tangents - d * (d.transpose() * tangents)) / length};
}

double AxisEstimate::turned_rad(double from_encoder_rad, double to_encoder_rad) const {
  const Vector2d apart(std::cos(to_encoder_rad) - std::cos(from_encoder_rad),
                       std::sin(to_encoder_rad) - std::sin(from_encoder_rad));
  return turn * (to_encoder_rad - from_encoder_rad) + once_a_turn_rad.dot(apart);
}

double AxisEstimate::rate(double encoder_rad) const {
  return turn + once_a_turn_rad.dot(Vector2d(-std::sin(encoder_rad), std::cos(encoder_rad)));
}

Tangents tangents_across(const Vector3d& direction) {
  Tangents out;
  out.col(0) = direction.unitOrthogonal();
  out.col(1) = direction.cross(out.col(0));
  return out;
}

Parameters::Parameters(const Estimate& about)
    : camera(about.camera),
      print{about.pitch.x(), about.pitch.y(), about.sag_mm.x(), about.sag_mm.y(), about.sag_mm.z()} {
  if (about.axis) turn = {about.axis->turn, about.axis->once_a_turn_rad.x(), about.axis->once_a_turn_rad.y()};
  if (about.elevation) elevation[4] = about.elevation->scale;
  if (about.lift) lift[2] = about.lift->scale;
  if (about.platter) platter = {about.platter->height_mm, about.platter->slope.x(), about.platter->slope.y()};
  planes.assign(about.planes.size(), {});
  poses.assign(about.X_CB.size(), {});
}

Estimate Parameters::moved(const Estimate& about) const {
  Estimate out = about;
  out.camera = camera;
  out.pitch = {print[0], print[1]};
  out.sag_mm = {print[2], print[3], print[4]};
  if (out.axis) {
    out.axis->direction_C = moved_direction(about.axis->direction_C, about.axis->across_C, axis.data()).d;
    out.axis->point_C += about.axis->across_C * Vector2d(axis[2], axis[3]);
    out.axis->turn = turn[0];
    out.axis->once_a_turn_rad = {turn[1], turn[2]};
  }
  if (out.platter) out.platter = PlatterEstimate{platter[0], {platter[1], platter[2]}};
  if (out.elevation) {
    const ElevationEstimate& at = *about.elevation;
    out.elevation->direction_C = moved_direction(at.direction_C, at.across_C, elevation.data()).d;
    out.elevation->point_C += at.across_C * Vector2d(elevation[2], elevation[3]);
    out.elevation->scale = elevation[4];
  }
  if (out.lift) {
    out.lift->direction_C = moved_direction(about.lift->direction_C, about.lift->across_C, lift.data()).d;
    out.lift->scale = lift[2];
  }
  for (std::size_t i = 0; i < planes.size(); ++i) {
    PlaneEstimate& plane = out.planes[i];
    plane.normal_C = moved_direction(plane.normal_C, plane.tangents_C, planes[i].data()).d;
    plane.distance_mm = plane.normal_C.dot(plane.anchor_C) + planes[i][2];
    plane.anchor_C += plane.normal_C * planes[i][2];
    plane.tangents_C = tangents_across(plane.normal_C);
  }
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const Vector3d turned(poses[i][0], poses[i][1], poses[i][2]), shifted(poses[i][3], poses[i][4], poses[i][5]);
    const double angle = turned.norm();
    if (angle > 0) {
      // Products of rotations drift from orthonormal: the quaternion brings them back.
      const Matrix3d R = Eigen::AngleAxisd(angle, turned / angle).toRotationMatrix() * about.X_CB[i].linear();
      out.X_CB[i].linear() = Eigen::Quaterniond(R).normalized().toRotationMatrix();
    }
    out.X_CB[i].translation() += shifted;
  }
  return out;
}

Eigen::Isometry3d seen_from_stop(const Estimate& estimate, const AxisStop& stop) {
  Eigen::Isometry3d out = Eigen::Isometry3d::Identity();
  if (estimate.lift && stop.lift_mm != 0) {
    out.translation() = estimate.lift->scale * stop.lift_mm * estimate.lift->direction_C;
  }
  if (estimate.elevation && stop.elevation_rad != 0) {
    const ElevationEstimate& axis = *estimate.elevation;
    out = Eigen::Translation3d(axis.point_C) * Eigen::AngleAxisd(-axis.scale * stop.elevation_rad, axis.direction_C) *
          Eigen::Translation3d(-axis.point_C) * out;
  }
  return out;
}

Eigen::Isometry3d scanner_frame(const Estimate& estimate) {
  const AxisEstimate& axis = *estimate.axis;
  const Vector3d z = axis.direction_C;
  const Vector3d origin = axis.point_C + (estimate.platter ? estimate.platter->height_mm : 0.0) * z;
  // Seen from above, towards the camera.
  Vector3d towards = -origin + z * z.dot(origin);
  Vector3d x = towards;
  if (!estimate.planes.empty()) {
    const Vector3d along = estimate.planes.front().normal_C.cross(z);
    if (along.norm() > 1e-6) x = along.dot(towards) < 0 ? Vector3d(-along) : along;
  }
  if (x.norm() < 1e-9) x = z.unitOrthogonal();
  x = (x - z * z.dot(x)).normalized();
  Eigen::Isometry3d X_CW = Eigen::Isometry3d::Identity();
  X_CW.linear() << x, z.cross(x), z;
  X_CW.translation() = origin;
  return X_CW;
}

Estimate anchored(const Estimate& estimate) {
  Estimate out = estimate;
  if (!out.axis) {
    for (PlaneEstimate& plane : out.planes) plane.tangents_C = tangents_across(plane.normal_C);
    return out;
  }
  const Eigen::Isometry3d X_CW = scanner_frame(estimate);
  const Tangents across = X_CW.linear().leftCols<2>();
  if (out.platter) {
    // The slope is a vector across the axis: its coordinates turn with the chart.
    out.platter->slope = across.transpose() * (out.axis->across_C * out.platter->slope);
    out.platter->height_mm = 0;
  }
  out.axis->across_C = across;
  out.axis->point_C = X_CW.translation();
  const Vector3d up = X_CW.linear().col(2);
  for (PlaneEstimate& plane : out.planes) {
    const Vector3d n = plane.normal_C;
    plane.anchor_C = X_CW.translation() + n * (plane.distance_mm - n.dot(X_CW.translation()));
    plane.tangents_C = upward_and_across(n, up);
  }
  if (out.elevation) {
    ElevationEstimate& axis = *out.elevation;
    axis.across_C = upward_and_across(axis.direction_C, up);
    // Along the line, to where its distance from the rotary axis, seen from above, is smallest.
    const Vector3d level = axis.direction_C - up * up.dot(axis.direction_C);
    if (level.norm() > 1e-6) {
      axis.point_C -= axis.direction_C * level.dot(axis.point_C - X_CW.translation()) / level.squaredNorm();
    }
  }
  if (out.lift) out.lift->across_C = across;
  return out;
}

}  // namespace celadon::calibrate
