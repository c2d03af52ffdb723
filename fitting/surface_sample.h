#pragma once
// A bounded sample of a point cloud with normals, made for noise that is not known. Source: README.md, "Frames".

#include <Eigen/Core>

namespace celadon {

struct SurfaceSample {
  Eigen::Matrix3Xd points;  ///< every point has the same chance to be one: outliers keep their share
  Eigen::VectorXd weights;  ///< one a point: 1, or 0 where neighbours are four times as far as usual
  /// Planes through neighbourhoods: their middles, not the points themselves, so that a neighbourhood that is cut off
  /// by the edge of the surface gives the normal of the place it stands for.
  Eigen::Matrix3Xd middles, normals;
  Eigen::VectorXd normal_weights;  ///< 1, or 0 where the neighbourhood is no plane
  int neighbours = 0;              ///< in a neighbourhood
  double noise_mm = 0;             ///< median standard deviation about the planes, the least bending included
  double normal_noise_rad = 0;     ///< standard deviation of a normal by that noise
};

/// Neighbourhoods start with 12 points and double while normals are less sure than 0.01 rad and the deviation from the
/// planes does not grow with them (noise; where they bend it grows in proportion), up to a sixth of the sample. A few
/// of them decide.
/// @pre points finite, at least 12
SurfaceSample sample_surface(const Eigen::Matrix3Xd& points, int most_points = 6000, int most_normals = 1000);

}  // namespace celadon
