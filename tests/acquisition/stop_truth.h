#pragma once
// Where the camera sees a point of the object with head and lift off 0: written from CALIBRATION.md with Rodrigues'
// formula, sharing no code with acquisition.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

#include "acquisition/calibration.h"

namespace celadon {

inline Eigen::Vector3d rotated_about(const Eigen::Vector3d& p, const Eigen::Vector3d& origin, const Eigen::Vector3d& k,
                                     double angle_rad) {
  const Eigen::Vector3d v = p - origin;
  const double c = std::cos(angle_rad), s = std::sin(angle_rad);
  return origin + c * v + s * k.cross(v) + (1 - c) * k.dot(v) * k;
}

/// p_C of the point p_W of the object (table angle 0, lift 0).
inline Eigen::Vector3d seen_at_stop(const Calibration& c, const Eigen::Vector3d& p_W, double table_angle_rad,
                                    const AxisStop& stop) {
  Eigen::Vector3d p_S = rotated_about(p_W, Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitZ(), table_angle_rad);
  if (c.lift) p_S += c.lift->scale.value * stop.lift_mm * c.lift->direction;
  if (c.elevation) {
    p_S = rotated_about(p_S, c.elevation->origin_mm, c.elevation->direction,
                        -c.elevation->scale.value * stop.elevation_rad);
  }
  return c.axis.X_CW.linear() * (p_S / c.scale.value) + c.axis.X_CW.translation();
}

}  // namespace celadon
