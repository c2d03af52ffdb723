#pragma once
// Turning about the table's axis.

#include <Eigen/Core>

namespace celadon::sim {

/// p turned about z by the angle of this cosine and sine.
inline Eigen::Vector3d turned(const Eigen::Vector3d& p, double cos_a, double sin_a) {
  return {cos_a * p.x() - sin_a * p.y(), sin_a * p.x() + cos_a * p.y(), p.z()};
}

}  // namespace celadon::sim
