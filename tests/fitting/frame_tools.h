#pragma once
// Clouds of closed-form surfaces around the z axis, in any place and attitude, with noise and strays.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <random>

namespace celadon::test {

using Random = std::mt19937_64;

inline double uniform(Random& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}
inline double normal(Random& random) {
  return std::normal_distribution<double>()(random);
}

inline Eigen::Isometry3d random_motion(Random& random, double reach) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  const Eigen::Quaterniond q(normal(random), normal(random), normal(random), normal(random));
  X.linear() = q.normalized().toRotationMatrix();
  for (int j = 0; j < 3; ++j) X.translation()[j] = uniform(random, -reach, reach);
  return X;
}

/// Even over the sphere's area, from the pole at +z down to this polar angle.
inline Eigen::Matrix3Xd sphere_cap(Random& random, int count, double radius, double polar_rad) {
  Eigen::Matrix3Xd points(3, count);
  for (int k = 0; k < count; ++k) {
    const double u = uniform(random, std::cos(polar_rad), 1), t = uniform(random, 0, 2 * std::numbers::pi);
    const double s = std::sqrt(1 - u * u);
    points.col(k) << radius * s * std::cos(t), radius * s * std::sin(t), radius * u;
  }
  return points;
}

/// (r cos t, squeeze r sin t, z) with r = meridian(z), even in z and in t over [0, arc).
template <class Meridian>
Eigen::Matrix3Xd around_axis(Random& random, int count, const Meridian& meridian, double z_low, double z_high,
                             double arc_rad, double squeeze = 1) {
  Eigen::Matrix3Xd points(3, count);
  for (int k = 0; k < count; ++k) {
    const double z = uniform(random, z_low, z_high), t = uniform(random, 0, arc_rad), r = meridian(z);
    points.col(k) << r * std::cos(t), squeeze * r * std::sin(t), z;
  }
  return points;
}

inline Eigen::Matrix3Xd cylinder_sector(Random& random, int count, double radius, double half_length, double arc_rad) {
  return around_axis(
      random, count, [=](double) { return radius; }, -half_length, half_length, arc_rad);
}

/// Independent normal errors of every coordinate.
inline void add_noise(Random& random, Eigen::Matrix3Xd& points, double sigma) {
  for (Eigen::Index k = 0; k < points.size(); ++k) points.data()[k] += sigma * normal(random);
}

/// A share of the points anywhere in the box of all, widened by half.
inline void add_strays(Random& random, Eigen::Matrix3Xd& points, double share) {
  const Eigen::Vector3d low = points.rowwise().minCoeff(), high = points.rowwise().maxCoeff();
  for (Eigen::Index k = 0; k < points.cols(); ++k) {
    if (uniform(random, 0, 1) >= share) continue;
    for (int j = 0; j < 3; ++j) {
      const double more = (high[j] - low[j]) / 4;
      points(j, k) = uniform(random, low[j] - more, high[j] + more);
    }
  }
}

inline Eigen::Matrix3Xd moved(const Eigen::Isometry3d& X, const Eigen::Matrix3Xd& points) {
  return (X.linear() * points).colwise() + X.translation();
}

/// Between two lines through the origin, degrees.
inline double angle_deg(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), std::abs(a.dot(b))) * 180 / std::numbers::pi;
}

/// Of a point from the line through X's origin along its z.
inline double off_axis(const Eigen::Isometry3d& X, const Eigen::Vector3d& point) {
  return (X.inverse() * point).head<2>().norm();
}

}  // namespace celadon::test
