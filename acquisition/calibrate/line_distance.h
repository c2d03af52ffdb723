#pragma once
// Points on a laser's line: from the board's plane to the laser's, and on the laser plane alone, with derivatives.
// README.md, (3) to (5).

#include <Eigen/Core>

#include "acquisition/calibrate/estimate.h"

namespace celadon::calibrate {

/// Signed distance h of the place where a ray meets the board from the laser plane.
struct LineDistance {
  bool exists = false;  ///< false: the ray misses the board, or runs along it
  double h_mm = 0;
  double per_px = 0;  ///< |gradient of h by the pixel|, mm/px
  Eigen::Vector3d by_board_normal, by_board_point, by_laser_normal;
  Eigen::Matrix<double, 1, 9> by_camera;
};
/// @param m_C, t_C normal and any point of the board's plane
LineDistance line_distance(const Ray& ray, const Eigen::Vector3d& m_C, const Eigen::Vector3d& t_C,
                           const Eigen::Vector3d& normal_C, double distance_mm);

/// The place where a ray meets the laser plane.
struct LaserPoint {
  bool exists = false;
  Eigen::Vector3d p_C;
  Eigen::Matrix<double, 3, 2> by_pixel;
  Eigen::Matrix<double, 3, 9> by_camera;
  Eigen::Matrix3d by_normal;
  Eigen::Vector3d by_distance;
};
LaserPoint laser_point(const Ray& ray, const Eigen::Vector3d& normal_C, double distance_mm);

}  // namespace celadon::calibrate
