#pragma once
// The axis of a surface of revolution from its normals, which all meet it. Source: Pottmann and Randrup, "Rotational
// and helical surface approximation for reverse engineering", Computing 60, 1998; README.md, "Frames".

#include <Eigen/Core>
#include <optional>
#include <span>

namespace celadon {

/// The linear complex nearest to normal lines: the velocity c_bar + c x p of the motion that the surface slides along.
struct RotationAxis {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  ///< unit
  Eigen::Vector3d point_mm = Eigen::Vector3d::Zero();    ///< of the axis, nearest to the mean of the points
  double pitch_mm = 0;  ///< advance of the motion a radian; 0 for revolutions but for noise
  double miss_rad = 0;  ///< robust mean angle by which normals miss the axis, seen from their points
  /// Square root of the three eigenvalues (angles, ascending) of the motions' misfits: one small, revolution; two, a
  /// sphere or a cylinder within the noise; three, a sphere or a plane.
  Eigen::Vector3d misfits_rad = Eigen::Vector3d::Zero();
};

/// Least sum of w (c_bar . n + c . (p x n))^2 with |c| = 1, in centred and scaled coordinates; reweighted by Tukey's
/// biweight of the angle at the point, so that a quarter of wild normals does no harm. Translations along which the
/// normals have no part (cylinders) are taken out of c_bar.
/// @param points, normals 3 x N, the normals of unit length, their sign does not matter
/// @param weights none, or N of them, not negative
/// @return nothing for fewer than six lines or points that coincide
std::optional<RotationAxis> rotation_axis(const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals,
                                          std::span<const double> weights = {});

}  // namespace celadon
